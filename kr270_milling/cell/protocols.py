"""The protocols of a cell's nodes, with the models that its parameters make."""

from __future__ import annotations

import math

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import commanded_joints, compensator, pass_record
from kr270_milling.cell.plant import imperfect_course
from kr270_milling.compensation.protocol import CompensatorModels, CompensatorProtocol
from kr270_milling.robot.urdf import urdf
from kr270_milling.simulation.protocol import CutProtocol, RobotModels, RobotProtocol

__all__ = ["compensator_protocol", "cut_protocol", "robot_protocol"]

CLOCK_PERIOD = 0.01  # [s] of the pass, at least, from one clock message to the next


def robot_protocol(cell: Cell, deflection_every: int | None = None) -> RobotProtocol:
    """Of the compliant robot; deflection_every: exchange periods from one to the next, default: as ``publish`` says."""
    thinned = cell.thinned_steps
    models = RobotModels(
        clock=cell.clock,
        iterations=cell.exchange.iterations,
        deflection_every=deflection_every or thinned,
        joints_every=thinned,
        clock_every=cell.steps_of(CLOCK_PERIOD),
        arm_model=cell.arm_model,
        course=lambda reference, number: imperfect_course(cell, reference, number),
        joints_along=cell.joints_along,
        description=urdf(cell.arm, cell.mount, cell.tool.radius, cell.workpiece.pose),
        warn_correction=cell.exchange.warn_correction,
        tooth_rate=cell.tool.spindle_speed / (2 * math.pi) * cell.tool.teeth,
    )
    return RobotProtocol(models)


def cut_protocol(cell: Cell) -> CutProtocol:
    """Of the cutting process."""
    return CutProtocol(cell.clock, cell.stock, cell.cut)


def compensator_protocol(cell: Cell, plant: Cell | None = None) -> CompensatorProtocol:
    """Of the trajectory compensator; plant: the cell that is simulated in the place of a real one, and its tracker."""
    models = CompensatorModels(
        clock=cell.clock,
        iterations=cell.exchange.iterations,
        compensator=lambda target, method: compensator(cell, target, method),
        pass_record=lambda number, time_ns, tool, wrench: pass_record(
            cell, time_ns, tool, wrench, None if plant is None else plant.imperfections, number
        ),
        joints=lambda reference: commanded_joints(cell, reference),
    )
    return CompensatorProtocol(models)
