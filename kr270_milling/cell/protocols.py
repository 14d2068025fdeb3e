"""The protocols of a cell's nodes, with the models that its parameters make."""

from __future__ import annotations

import math

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import commanded_joints, compensator, pass_record
from kr270_milling.compensation.protocol import CompensatorModels, CompensatorProtocol
from kr270_milling.robot.urdf import urdf
from kr270_milling.simulation.protocol import CutProtocol, RobotModels, RobotProtocol

__all__ = ["compensator_protocol", "cut_protocol", "robot_protocol"]


def robot_protocol(cell: Cell) -> RobotProtocol:
    """Of the compliant robot."""
    models = RobotModels(
        clock=cell.clock,
        iterations=cell.exchange.iterations,
        thinned=cell.thinned_steps(),
        arm_model=cell.arm_model,
        joints_at=cell.joints_at,
        description=urdf(cell.arm, cell.mount, cell.tool.radius, cell.workpiece.pose),
        warn_correction=cell.exchange.warn_correction,
        tooth_rate=cell.tool.spindle_speed / (2 * math.pi) * cell.tool.teeth,
    )
    return RobotProtocol(models)


def cut_protocol(cell: Cell) -> CutProtocol:
    """Of the cutting process."""
    return CutProtocol(cell.clock, cell.stock, cell.cut)


def compensator_protocol(cell: Cell) -> CompensatorProtocol:
    """Of the trajectory compensator."""
    models = CompensatorModels(
        clock=cell.clock,
        iterations=cell.exchange.iterations,
        compensator=lambda target, method: compensator(cell, target, method),
        pass_record=lambda stamps, positions, wrench: pass_record(cell, stamps, positions, wrench),
        joints=lambda reference: commanded_joints(cell, reference),
    )
    return CompensatorProtocol(models)
