"""A milling cell: the sections of its parameter file and the conditions between them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.frames import JOINT_NAMES
from kr270_milling.base.record import Record, derived, parameter, section
from kr270_milling.cell.paths import StraightCut
from kr270_milling.cell.sections import Limits, PathSection, Program, Tolerances, Uncertainty, Workpiece
from kr270_milling.cell.stage import Removal, Stage
from kr270_milling.path.kinematics import Kinematics
from kr270_milling.path.timing import Timing
from kr270_milling.physics.compensation.settings import CompensationSettings
from kr270_milling.physics.cutting import Cutting, Stock, Tool
from kr270_milling.physics.motion.arm_model import Dynamics
from kr270_milling.physics.motion.imperfections import Imperfections
from kr270_milling.physics.motion.periods import Exchange, Publish
from kr270_milling.physics.robot import Arm, Mount
from kr270_milling.physics.robot.sensor import ForceSensor


@dataclass(frozen=True, eq=False, kw_only=True)
class Cell(Record):
    """The sections of a parameter file; lengths in metres, workpiece axes. Its models: ``models.py``."""

    start_joints: np.ndarray = parameter(
        [], unit="deg", low=-720.0, high=720.0, text="where the path starts, six joints: workpiece.at_start_joints"
    )
    posture_hint: np.ndarray = parameter(
        [], unit="deg", low=-720.0, high=720.0, text="six joints near those of the path: they choose the branch"
    )
    joint_names: tuple[str, ...] = parameter(
        JOINT_NAMES, text="names of the six joints in joint_states, joint_trajectory and robot_description"
    )
    arm: Arm
    mount: Mount
    sensor: ForceSensor = section(ForceSensor)
    workpiece: Workpiece
    tool: Tool
    cutting: Cutting
    stock: Stock
    path: PathSection
    machine: Kinematics = section(Kinematics)
    dynamics: Dynamics
    exchange: Exchange
    compensation: CompensationSettings
    publish: Publish = section(Publish)
    timing: Timing = section(Timing)
    krl: Program = section(Program, key="program")
    limits: Limits = section(Limits)
    uncertainty: Uncertainty = section(Uncertainty)
    tolerances: Tolerances = section(Tolerances, key="part")
    imperfections: Imperfections = section(Imperfections)
    stage: Stage | None = derived(None)  #: in a program with several tools; None: one tool, an uncut stock

    def check(self) -> None:
        turn = 2.0 * np.pi / self.exchange.micro_step
        if abs(turn - round(turn)) > 1e-6:
            raise ParameterError("exchange.micro_step_deg", np.degrees(self.exchange.micro_step), "a whole part of 360")
        for key, value in (("start_joints_deg", self.start_joints), ("posture_hint_deg", self.posture_hint)):
            if value.size not in (0, 6):
                raise ParameterError(key, np.degrees(value).tolist(), "six joint positions")
        if self.workpiece.at_start_joints and not (self.path.length and self.path.feed_rate):
            allowed = "false without a straight cut in path; give xyz_mm and abc_deg"
            raise ParameterError("workpiece.at_start_joints", True, allowed)
        if self.workpiece.at_start_joints and not self.start_joints.size:
            raise ParameterError("start_joints_deg", [], "six joint positions for workpiece.at_start_joints")
        if not self.start_joints.size and not self.posture_hint.size:
            raise ParameterError("posture_hint_deg", None, "six joint positions (or give start_joints_deg)")
        if len(set(self.joint_names)) != 6 or len(self.joint_names) != 6 or not all(self.joint_names):
            raise ParameterError("joint_names", list(self.joint_names), "six different names")
        if not self.tool.has_flat_end and not self.path.file:
            raise ParameterError("tool.type", self.tool.type, "flat for a straight cut; other ends need a program")
        if not self.tool.has_flat_end and self.cutting.detail == "teeth":
            reason = f"the sweep of the teeth knows flat ends only, and tool.type is {self.tool.type}"
            raise ParameterError("cutting.detail", "teeth", f"engagement or auto: {reason}")
        if self.cutting.by_engagement and not self.path.file:
            raise ParameterError("cutting.detail", "engagement", "teeth or auto for a straight cut")
        stated = math.isfinite(self.exchange.period)  # else the reader of the file chooses it
        if self.tool.spindle_speed > 0.0:
            if stated:
                self.exchange.clock(self.tool.spindle_speed)
        elif self.path.recorded or not self.path.file:
            raise ParameterError("tool.spindle_speed_rpm", 0.0, "above 0 where no program states it")
        if not self.path.file and stated:
            StraightCut(self.path, self.stock, self.tool, self.timing, self.exchange).check()

    def __repr__(self) -> str:
        return f"<Cell {self.arm.name}: {self.path.name}>"

    @property
    def posture_key(self) -> str:
        """Key of the joint positions that choose the branch."""
        return "start_joints_deg" if self.start_joints.size else "posture_hint_deg"

    @property
    def earlier(self) -> tuple[Removal, ...]:
        """Material that the earlier tools of the program remove."""
        return self.stage.earlier if self.stage else ()

    def by_mean_force(self, level: bool = True) -> Cell:
        """Return the cell cut with the mean force of the engagement, at the period and on the grid of that model.

        level: the end is flat and the axis upright.
        """
        return self.replace(
            cutting=self.cutting.replace(detail="engagement"),
            exchange=self.exchange.for_engagement(self.tool.spindle_speed, level),
            stock=self.stock.for_engagement(float(self.tool.radii.max())),
        )

    def after(self, earlier: tuple[Removal, ...]) -> Cell:
        """The cell of a tool after the passes of the earlier tools of its program."""
        return self.replace(stage=replace(self.stage, earlier=earlier)) if self.stage else self
