"""The parameter file of one milling cell as records: where each section lives, and what they must agree in."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from kr270_milling.bag.recorded_path import is_recording
from kr270_milling.base.errors import ParameterError
from kr270_milling.base.frames import Pose
from kr270_milling.base.record import Record, parameter, specs
from kr270_milling.cell.plausibility import MOST_STEPS, check_effort
from kr270_milling.cell.sections import Limits, Part, Program, Uncertainty
from kr270_milling.compensation.parameters import Compensation
from kr270_milling.cutting import Cutting, Stock, Tool
from kr270_milling.robot import Arm, Mount
from kr270_milling.simulation.exchange import Exchange, Publish
from kr270_milling.simulation.imperfections import Imperfections
from kr270_milling.simulation.parameters import Dynamics
from kr270_milling.trajectory.timing import Timing

__all__ = ["Parameters", "Path", "Workpiece"]


@dataclass(frozen=True, eq=False)
class Workpiece(Record):
    """YAML ``workpiece``: where the part is clamped."""

    xyz: np.ndarray = parameter(
        [], unit="mm", low=-1e5, high=1e5, text="origin of the workpiece frame on base_link, three numbers"
    )
    abc: np.ndarray = parameter(
        [], unit="deg", low=-360.0, high=360.0, text="its orientation, KUKA A, B, C, three numbers"
    )
    at_start_joints: bool = parameter(
        False, text="place it so that start_joints_deg put the tool where the straight cut starts; xyz, abc follow"
    )
    fixtures: np.ndarray = parameter(
        [], unit="mm", low=-1e5, high=1e5,
        text="boxes that the tool must not enter, workpiece frame: x, y, z of both corners, one box after the other",
    )  # fmt: skip

    def check(self) -> None:
        for key, value, scale in (("xyz_mm", self.xyz, 1e3), ("abc_deg", self.abc, 180.0 / np.pi)):
            if value.size != 3 and not (self.at_start_joints and value.size == 0):
                allowed = "three numbers (or, for a straight cut, give at_start_joints: true instead)"
                if not value.size:
                    raise ParameterError(key, None, f"is missing; it must be {allowed}")
                raise ParameterError(key, (value * scale).tolist(), allowed)
        if self.fixtures.size % 6:
            raise ParameterError("fixtures_mm", (1e3 * self.fixtures).tolist(), "six numbers for each box")

    @property
    def fixture_boxes(self) -> np.ndarray:
        """Lower and upper corner of each box [m], (n, 2, 3), workpiece frame."""
        return np.sort(self.fixtures.reshape(-1, 2, 3), axis=1)

    @property
    def pose(self) -> Pose:
        """workpiece -> base_link."""
        return Pose.from_abc(self.xyz, self.abc)


@dataclass(frozen=True, eq=False)
class Path(Record):
    """YAML ``path``: a tool path file, or a straight cut along +x of the workpiece frame."""

    file: str = parameter(
        "", text="G-code, APT/CL, CSV of points or a recording of a path, workpiece frame; empty: a straight cut"
    )
    topic: str = parameter("", text="of a recording: where its path is, if several topics hold one")
    tool: str = parameter("", text="of a program with several tools: whose moves are run, as T1")
    start: np.ndarray = parameter(
        [0.0, 0.0], unit="mm", size=2, low=-1e5, high=1e5, text="straight cut: x, y of the tool tip at the start"
    )
    depth_of_cut: float = parameter(0.0, unit="mm", low=0.0, high=100.0, text="straight cut: a_p below the stock's top")
    length: float = parameter(0.0, unit="mm", low=0.0, high=10000.0, text="straight cut: its length")
    feed_rate: float = parameter(
        0.0, unit="m_per_min", low=0.0, high=60.0,
        text="feed rate v_f of a straight cut, a program without F, or a recorded path whose poses have one stamp",
    )  # fmt: skip

    radial_immersion: float = parameter(
        1.0, above=0.0, high=1.0, text="stability: width of the cut, a share of the diameter"
    )
    mode: str = parameter("slot", choices=("slot", "up", "down"), text="stability: sense of a cut that is no slot")

    def check(self) -> None:
        if self.topic and not is_recording(self.file):
            raise ParameterError("topic", self.topic, "empty where path.file is no recording (.mcap)")
        for spec in specs(Path):
            if not self.file and spec.kind is float and not getattr(self, spec.name) > 0.0:
                value = getattr(self, spec.name) / spec.scale
                raise ParameterError(spec.key, value, "above 0 for a straight cut (or give path.file)")


@dataclass(frozen=True, eq=False, kw_only=True)
class Parameters(Record):
    """The whole parameter file."""

    start_joints: np.ndarray = parameter(
        [], unit="deg", low=-720.0, high=720.0, text="where the path starts, six joints: workpiece.at_start_joints"
    )
    posture_hint: np.ndarray = parameter(
        [], unit="deg", low=-720.0, high=720.0, text="six joints near those of the path: they choose the branch"
    )
    arm: Arm
    mount: Mount
    workpiece: Workpiece
    tool: Tool
    cutting: Cutting
    stock: Stock
    path: Path
    dynamics: Dynamics
    exchange: Exchange
    compensation: Compensation
    publish: Publish = dataclasses.field(default_factory=Publish)
    timing: Timing = dataclasses.field(default_factory=Timing)
    program: Program = dataclasses.field(default_factory=Program)
    limits: Limits = dataclasses.field(default_factory=Limits)
    uncertainty: Uncertainty = dataclasses.field(default_factory=Uncertainty)
    part: Part = dataclasses.field(default_factory=Part)
    imperfections: Imperfections = dataclasses.field(default_factory=Imperfections)

    def check(self) -> None:
        turn = 2.0 * np.pi / self.exchange.micro_step
        if abs(turn - round(turn)) > 1e-6:
            raise ParameterError("exchange.micro_step_deg", np.degrees(self.exchange.micro_step), "a whole part of 360")
        self._check_posture()
        programmed = self.path.file and not is_recording(self.path.file)
        if self.tool.spindle_speed > 0.0:
            self.exchange.clock(self.tool.spindle_speed)
        elif not programmed:
            raise ParameterError("tool.spindle_speed_rpm", 0.0, "above 0 where no program says it")
        if self.path.file:
            return
        steps = self.path.length / self.path.feed_rate / min(self.exchange.period, self.timing.controller_step)
        if not steps <= MOST_STEPS:
            shown = self.path.feed_rate * 60.0
            allowed = f"faster: the pass would take {steps:.3g} steps, more than {MOST_STEPS:g}"
            raise ParameterError("path.feed_rate_m_per_min", shown, allowed)
        check_effort(self.exchange, self.tool, self.stock, self.path.length / self.path.feed_rate)

    def _check_posture(self) -> None:
        """Six joints, once: where the path starts, or near it."""
        placed = self.workpiece.at_start_joints
        given = {"start_joints_deg": self.start_joints, "posture_hint_deg": self.posture_hint}
        for key, value in given.items():
            if value.size not in (0, 6):
                raise ParameterError(key, np.degrees(value).tolist(), "six joint positions")
        if placed and not (self.path.length and self.path.feed_rate):
            allowed = "false without a straight cut in path; give xyz_mm and abc_deg"
            raise ParameterError("workpiece.at_start_joints", True, allowed)
        if placed and not self.start_joints.size:
            raise ParameterError("start_joints_deg", [], "six joint positions for workpiece.at_start_joints")
        if not self.start_joints.size and not self.posture_hint.size:
            allowed = "is missing; it must be six joint positions (or give start_joints_deg)"
            raise ParameterError("posture_hint_deg", None, allowed)

    @property
    def posture(self) -> np.ndarray:
        """Joint positions [rad], (6,), at the start of the path or near them; they choose the branch."""
        return self.start_joints if self.start_joints.size else self.posture_hint
