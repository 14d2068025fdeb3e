"""Read the cell of a parameter file; write a cell as a file that a node and ``read_cell`` read back bit for bit."""

from __future__ import annotations

import contextlib
import math
import pathlib
import re
from collections.abc import Sequence

import numpy as np
import yaml

from kr270_milling.base.errors import ConfigError, InputError, ParameterError
from kr270_milling.base.frames import Pose, abc_from_rotation, rotation_from_quaternion
from kr270_milling.base.parameter_file import merge, override, read_tree
from kr270_milling.base.record import build, specs, tree_of
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.models import removal_of
from kr270_milling.cell.paths import BY_TEETH, StraightCut
from kr270_milling.cell.sections import Workpiece
from kr270_milling.cell.stage import Stage
from kr270_milling.path.cam.readers import find_tool_path
from kr270_milling.path.source_program import ProgramTool, SourceProgram
from kr270_milling.physics.robot import pose

#: sections that a tool may override; its other keys are those of ``tool``
SECTIONS = ("compensation", "cutting", "dynamics", "exchange", "limits", "mount", "part", "program", "stock", "timing")


def read_cell(path, assignments=()) -> Cell:
    """The cell of a parameter file, with ``key=value`` texts on top; raises ConfigError, InputError.

    What a program says and the file does not, the spindle speed, is taken from the program. A file with ``tools``
    gives the cell of ``path.tool``.
    """
    cells = read_cells(path, assignments)
    if len(cells) > 1:
        advice = f"choose one with --set path.tool={cells[0].path.tool}"
        raise ConfigError(path, "tools", None, f"has {len(cells)} tools, and one cell is wanted: {advice}")
    return cells[0]


def read_cells(path, assignments=()) -> tuple[Cell, ...]:
    """The cells of all ``tools`` of a parameter file, in the order of the program; one cell without ``tools``.

    ``path.tool`` chooses one of the tools. The earlier tools leave their programmed part until ``Cell.after`` states
    their passes. Raises ConfigError, InputError.
    """
    below = read_tree(path)
    tree, assigned = override(below, assignments)
    name = tree.get("path", {}).get("file") if isinstance(tree.get("path"), dict) else None
    if isinstance(name, str) and name:
        tree["path"]["file"] = str(find_tool_path(name, pathlib.Path(path).parent))
    if "tools" not in tree:
        return (_one_cell(tree, assigned, path),)
    chosen = tree.get("path", {}).get("tool", "") if isinstance(tree.get("path"), dict) else ""
    by_tool = {name: _cell_of_tool(name, own, assigned, path) for name, own in _tool_trees(tree, path).items()}
    runs = _in_program_order(tuple(by_tool), next(iter(by_tool.values())).path.source, path)
    for run in runs:
        if run.name not in by_tool:
            by_tool[run.name] = _cell_of_tool(run.name, _tree_of_tool(tree, run.name, path), assigned, path)
    if chosen and chosen not in [run.name for run in runs]:
        raise ConfigError(path, "path.tool", chosen, f"one of {', '.join(run.name for run in runs)}")
    cells = [by_tool[run.name] for run in runs]
    if not cells[0].path.offsets.size and len(names := {cell.path.source.work_offset or "G54" for cell in cells}) > 1:
        reason = f"is missing: the tools cut in {' and '.join(sorted(names))}; state x, y and z of each from G54 on"
        raise ConfigError(path, "path.offsets_mm", None, reason)
    cut = [removal_of(cell) for cell in cells]
    tips = [cell.mount.xyz.tolist() for cell in cells]
    stages = [
        Stage(run.name, k + 1, len(cells), tuple(cut[:k]), tuple(cut[k + 1 :]), run.first and tips[k] in tips[:k])
        for k, run in enumerate(runs)
    ]
    staged = [_staged(cell, stage, path) for cell, stage in zip(cells, stages, strict=True)]
    return tuple(cell for cell in staged if chosen in ("", cell.path.tool))


def _staged(cell: Cell, stage: Stage, path) -> Cell:
    """The cell of one of several tools, with the name of the tool in that of the robot program."""
    try:
        krl = cell.krl.replace(name=cell.krl.name + stage.suffix)
    except ParameterError as error:
        raise ConfigError(path, "program.name", error.value, f"{error.allowed}, with the tool") from None
    return cell.replace(stage=stage, krl=krl)


def _cell_of_tool(name: str, tree: dict, assigned: frozenset, path) -> Cell:
    try:
        return _one_cell(tree, assigned, path)
    except ConfigError as error:
        key = re.sub(r"^tool\.", f"tools.{name}.", error.key)
        raise ConfigError(path, key, error.value, error.allowed) from None


def _one_cell(tree: dict, assigned: frozenset, path) -> Cell:
    """The placed cell of one tree, with its program, the spindle speed that it states and the cut that it needs."""
    cell = _placed(build(Cell, tree, path), assigned, path)
    cell = cell.replace(
        path=cell.path.replace(machine=cell.machine).loaded()
    )  # an error appears where the path is used
    try:
        return _with_cut_model(_with_spindle(_with_shape(cell)))
    except ParameterError as error:
        raise ConfigError(path, error.key, error.value, error.allowed) from None


def _with_shape(cell: Cell) -> Cell:
    """Return the cell with the shape that the comment of the tool states in full, where ``tool.type`` is program."""
    tool, program = cell.tool, cell.path.source.current
    stated = program.end(tool.radius) if program and tool.type == "program" else {}
    return cell.replace(tool=tool.replace(**stated)) if stated else cell


def _with_spindle(cell: Cell) -> Cell:
    if cell.tool.spindle_speed > 0.0:
        return cell
    speeds = cell.path.source.spindle_speeds
    if not speeds:
        raise ParameterError("tool.spindle_speed_rpm", 0.0, "above 0: the program in path.file has no spindle speed S")
    return cell.replace(tool=cell.tool.replace(spindle_speed=abs(speeds[0])))


def _with_cut_model(cell: Cell) -> Cell:
    """Return the cell with ``cutting.detail`` as teeth or engagement, and with the period and the grid of that model.

    A program that cannot be read leaves ``auto``: the error appears where the path is used.
    """
    detail, level = cell.cutting.detail, cell.tool.has_flat_end
    with contextlib.suppress(InputError):
        level = level and cell.path.tilt <= BY_TEETH
        if detail == "auto":
            long_cutting = 60.0  # [s]; a longer cut is not swept tooth by tooth
            detail = "teeth" if level and cell.path.cutting_time <= long_cutting else "engagement"
    if detail == "engagement":
        return cell.by_mean_force(level)
    speed = cell.tool.spindle_speed
    tooth = 2.0 * math.pi / (speed * cell.tool.teeth)  # [s]
    *feeds, length = cell.path.feeds
    exchange = cell.exchange.for_teeth(speed, cell.cutting.end_share)
    swept = float(cell.tool.radii.max()), exchange.micro_step, (feeds[0] * tooth, feeds[1] * tooth), length
    return cell.replace(
        cutting=cell.cutting.replace(detail=detail), exchange=exchange, stock=cell.stock.for_teeth(*swept)
    )


def _placed(cell: Cell, assigned: frozenset, path) -> Cell:
    """Return the cell with its workpiece where the start joints put the tool at the start of the straight cut.

    A place in the file must agree with this place; a place of the command line moves the workpiece.
    """
    workpiece = cell.workpiece
    if not workpiece.at_start_joints:
        return cell
    cut = StraightCut(cell.path, cell.stock, cell.tool, cell.timing, cell.exchange).target
    start = Pose(cut.position[0], rotation_from_quaternion(cut.quaternion[0]))
    derived = pose(cell.arm, cell.mount, cell.start_joints) @ start.inverse()
    place = {"xyz": derived.position, "abc": abc_from_rotation(derived.rotation)}
    moved = False
    for spec in (spec for spec in specs(Workpiece) if spec.name in place):
        stated = getattr(workpiece, spec.name)
        same_place = 1e-3  # [mm], [deg]
        if assigned & {f"workpiece.{spec.key}", "workpiece.base_kuka"}:
            moved = True
        elif stated.size and not np.allclose(stated, place[spec.name], rtol=0.0, atol=same_place * spec.scale):
            value = tree_of(workpiece)[spec.key]
            raise ConfigError(path, f"workpiece.{spec.key}", value, "left out: at_start_joints places the workpiece")
        if stated.size:
            del place[spec.name]
    return cell.replace(workpiece=workpiece.replace(at_start_joints=not moved, **place))


def _tool_trees(tree: dict, file) -> dict[str, dict]:
    """The trees of a cell for each of its ``tools``, by name; raises ConfigError."""
    tools, path = tree["tools"], tree.get("path")
    if not isinstance(tools, dict) or not tools or not all(isinstance(entry, dict) for entry in tools.values()):
        raise ConfigError(file, "tools", None, "must have a group of keys for each tool, for example T1: {teeth: 2}")
    if not isinstance(path, dict) or not path.get("file"):
        raise ConfigError(file, "tools", None, "needs a program in path.file")
    chosen = path.get("tool", "")
    if chosen and not {chosen, _tool_of(chosen)} & tools.keys():
        raise ConfigError(file, "path.tool", chosen, f"one of {', '.join(tools)}")
    return {name: _tree_of_tool(tree, name, file) for name in tools}


def _tool_of(run: str) -> str:
    """Return the name of a tool from that of a further run: T1 of T1_2."""
    return run.rpartition("_")[0]


def _tree_of_tool(tree: dict, name: str, file) -> dict:
    """The tree of a cell for a run of a tool; a further run without a group has that of the tool."""
    entry = tree["tools"].get(name) or tree["tools"][_tool_of(name)]
    if isinstance(entry.get("stock"), dict) and {"min_mm", "max_mm"} & set(entry["stock"]):
        raise ConfigError(file, f"tools.{name}.stock", None, "must not have min_mm, max_mm: the tools share one stock")
    sections = {key: value for key, value in entry.items() if key in SECTIONS}
    tool = {key: value for key, value in entry.items() if key not in SECTIONS}
    above = {**sections, "tool": tool, "path": {"tool": name}}
    return merge({key: value for key, value in tree.items() if key != "tools"}, above)


def _in_program_order(names: Sequence[str], program: SourceProgram, file) -> list[ProgramTool]:
    """The runs that cut, in their order; raises ConfigError for a tool that has no name here; file: of the cell."""
    cutters = [tool for tool in program.tools if tool.cuts]
    for tool in cutters:
        if not {tool.name, tool.changed_as} & set(names):
            raise ConfigError(file, f"tools.{tool.name}", None, f"is missing: the program cuts with {tool.label}")
    return cutters


def cell_text(cell: Cell) -> str:
    """Return the cell as YAML text; its numbers are read back bit for bit."""
    tree = _without_empty(tree_of(cell))
    if cell.path.file:
        tree["path"]["file"] = str(pathlib.Path(cell.path.file).resolve())
    text = yaml.safe_dump({"/**": {"ros__parameters": tree}}, sort_keys=False, default_flow_style=None, width=110)
    return "# Written by kr270_milling: the cell of this run.\n" + text


def write_cell_file(cell: Cell, path: pathlib.Path) -> None:
    path.write_text(cell_text(cell), encoding="utf-8")


def _without_empty(tree: dict) -> dict:
    """Remove empty lists, whose type ROS cannot derive, and groups that are then empty, which ROS refuses."""
    values = {key: _without_empty(value) if isinstance(value, dict) else value for key, value in tree.items()}
    return {key: value for key, value in values.items() if value or not isinstance(value, (list, dict))}
