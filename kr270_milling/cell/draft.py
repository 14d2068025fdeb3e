"""A first parameter file for a program: what the program says is filled in, the rest is marked as the user's."""

from __future__ import annotations

import math
import pathlib
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kr270_milling.cell.paths import check_moves
from kr270_milling.path.toolpath import Toolpath

#: YAML with places for str.format
TEMPLATE = pathlib.Path(__file__).with_name("draft.yaml").read_text(encoding="utf-8")

ROUNDING = 1e-3  #: [mm], of coordinates in inches
CLEARANCE = 0.5e-3  #: [m], between the stock and a cutter that comes down rapidly beside it
PLACE = (1500.0, 0.0, 800.0)  #: [mm], of the test piece, see config/test_piece.yaml
ON_DISPLAY = "{{X: {}, Y: {}, Z: {}, A: {}, B: {}, C: {}}}"
DIAMETER, TEETH, SPEED = 10.0, 4, 8000.0  #: [mm], -, [rpm], where the program does not state it
#: keys of a tool, below ``tool`` or below its name
TOOL = """\
      diameter_mm: {diameter}            # {diameter_source}{end}
      teeth: {teeth}                     # {teeth_source}
      rotation: clockwise                # yours: counterclockwise, with M4, for a left-hand cutter
      {speed}                            # {speed_source}"""
#: the line above the keys of several tools
TOOLS = "    tools:  # keys of tool, and sections that differ; yours: mount: {tool_kuka: {X: ...}} for its length\n"
#: values of the template for a slot along +x, which has no program
STRAIGHT_TOOL = {
    "diameter": DIAMETER, "diameter_source": "yours", "end": "", "teeth": TEETH, "teeth_source": "yours",
    "speed": f"spindle_speed_rpm: {SPEED}", "speed_source": "yours",
}  # fmt: skip
STRAIGHT = {
    "operations": "", "place": ON_DISPLAY.format(*PLACE, 0.0, 0.0, 0.0), "offset": "of the workpiece",
    "place_note": "yours: BASE_DATA from the display of the controller [mm, deg]; here the place of the shipped test "
    "piece, z up",
    "mounted": ON_DISPLAY.format(300.0, 0.0, 140.0, 180.0, -90.0, 0.0),
    "tool_note": "yours: TOOL_DATA of the spindle from the display of the controller",
    "tool": "    tool:\n" + TOOL.format(**STRAIGHT_TOOL), "low": "[0.0, -20.0, -10.0]",
    "stock_note": "yours: here the box of the path, the cutter and 5 mm",
    "name": "MILLING", "name_note": "yours: of the robot program",
    "high": "[60.0, 20.0, 0.0]", "spindle_on": "[]",
    "path": """\
      start_mm: [-8.0, 0.0]              # yours: a straight cut along +x; or give file: part.nc
      depth_of_cut_mm: 1.0               # yours
      length_mm: 40.0                    # yours
      feed_rate_m_per_min: 2.0           # yours""",
}  # fmt: skip


@dataclass(frozen=True)
class Box:
    """Corners [m], workpiece frame."""

    low: np.ndarray
    high: np.ndarray

    @property
    def area(self) -> float:
        """[m2], seen from above; 0 for a box without an inside."""
        return float(np.prod(np.maximum(self.high - self.low, 0.0)[:2]))


def stock_of(paths: Sequence[Toolpath]) -> tuple[Box, int]:
    """A block that the paths of a program cut, and the line of the first rapid move that it is cut back for, else 0.

    The box of the paths with cutter and allowance, without the places where the first cutter comes down rapidly; the
    others may go down where it has cut. Its top is at zero where a path cuts below zero, else where it moves sideways
    at the highest.
    """
    boxes = [_box_of(path, _diameter(path) / 2e3) for path in paths]
    whole = Box(np.min([box.low for box in boxes], axis=0), np.max([box.high for box in boxes], axis=0))
    return _beside_rapids(whole, paths[0], _diameter(paths[0]) / 2e3)


def _box_of(path: Toolpath, radius: float) -> Box:
    """The box of the cuts with cutter and allowance."""
    cuts = np.flatnonzero(~path.rapid)
    ends = np.concatenate([path.position[cuts], path.position[np.maximum(cuts - 1, 0)]])
    bottom = float(ends[:, 2].min())
    sideways = np.hypot(*np.diff(path.position[:, :2], axis=0, prepend=path.position[:1, :2]).T) > 1e-6
    level = path.position[~path.rapid & sideways, 2]
    top = 0.0 if bottom < -1e-6 else float(level.max(initial=bottom)) + 1e-3
    inside = ends[ends[:, 2] < top + 1e-9]
    inside = inside if len(inside) else ends
    allowance = 5e-3  # [m], around the path of the cutter and below it
    margin = radius + allowance
    low = np.floor((inside.min(axis=0)[:2] - margin) * 1e3 + ROUNDING) / 1e3
    high = np.ceil((inside.max(axis=0)[:2] + margin) * 1e3 - ROUNDING) / 1e3
    base = math.floor((bottom - allowance) * 1e3 + ROUNDING) / 1e3
    return Box(np.array([*low, base]), np.array([*high, top]))


def _beside_rapids(box: Box, path: Toolpath, radius: float) -> tuple[Box, int]:
    """The box cut back until no rapid move below the top meets it, but for holes and where the tool has cut before."""
    down = np.flatnonzero(path.rapid & ~path.drilling & (path.position[:, 2] < box.high[2] - 1e-6))
    places = 100_000  # of a path, at most
    distance, step = np.linspace(0.0, path.length, 2 + min(places, int(path.length / CLEARANCE)), retstep=True)
    tip, block = path.position_at(distance), path.block_at(distance)
    tip, block = tip[~path.rapid[block]], block[~path.rapid[block]]
    cut, lines = box, []
    _, first = np.unique(np.round(path.position[down], 5), axis=0, return_index=True)
    for number in down[first[:1000]].tolist():
        *place, height = path.position[number].tolist()
        cleared = ((block < number) & (tip[:, 2] < height + 1e-6)) | path.drilling[block]
        if (np.hypot(*(tip[cleared, :2] - place).T) < max(CLEARANCE, step)).any():
            continue
        nearest = np.clip(place, cut.low[:2], cut.high[:2])
        if math.dist(nearest, place) < radius + CLEARANCE:
            cut = max(_sides(cut, place, radius + CLEARANCE), key=lambda side: side.area)
            lines.append(int(path.line[number]))
    least_share = 0.2  # of the area that the path asks for; a stock that is cut down to less is no guess any more
    return (cut, min(lines, default=0)) if cut.area > least_share * box.area else (box, 0)


def _sides(box: Box, place: np.ndarray, margin: float) -> list[Box]:
    """The box without what lies on one side of a cutter, four ways."""
    sides = []
    for axis in (0, 1):
        low, high = box.low.copy(), box.high.copy()
        low[axis] = max(low[axis], place[axis] + margin)
        high[axis] = min(high[axis], place[axis] - margin)
        sides += [Box(low, box.high), Box(box.low, high)]
    return sides


def draft(file: str, paths: Sequence[Toolpath], robot: str) -> tuple[str, list[str]]:
    """The YAML of a cell for the paths of all tools of a program, in its order, which ``check`` reads unchanged.

    Beside it warnings: guesses that hide a danger if they are wrong. Raises InputError for a path without a cut.
    """
    for path in paths:
        check_moves(file, path, by_teeth=False)
    program = paths[0].program
    stock, line = (Box(*np.reshape(program.stock, (2, 3))), 0) if program.stock else stock_of(paths)
    warnings = [warning for path in paths for warning in _unsaid(path)]
    if len(frames := dict.fromkeys(path.program.work_offset or "G54" for path in paths)) > 1:
        warnings.append(f"the tools cut in {' and '.join(frames)}: check needs their places, path.offsets_mm")
    values = STRAIGHT | _common(file, paths[0], stock) | {"path": f"      file: {_quoted(file)}"}
    if program.stock:
        values["stock_note"] = "[source: the program]; compare it with the blank"
    if line:
        values["stock_note"] = f"yours: ends beside the rapid move of line {line}, which goes below its top"
        warnings.append(
            f"line {line}: a rapid move goes below the top of the cut: the stock is taken to end beside it; put "
            "stock.min_mm and stock.max_mm right, so that check finds a rapid move into the stock"
        )
    if len(paths) > 1:
        values |= {
            "operations": _words(f"{len(paths)} tools, which run in the order of the program"),
            "tool": TOOLS + "\n".join(map(_entry, paths)),
            "name_note": "yours: of the robot programs; the name of the tool is added",
        }
    else:
        several = sum(bool(known.cuts) for known in program.tools) > 1
        values["operations"] = _words(f"operations: {', '.join(program.operations)}" if program.operations else "")
        values["tool"] = "    tool:\n" + TOOL.format(**_tool(paths[0]))
        values["path"] += f"\n      tool: {_quoted(program.tool)}" if several else ""
    return _aligned(TEMPLATE.format(**values, robot=robot)), warnings


def _entry(path: Toolpath) -> str:
    """The lines of one of several tools; of a further run of a tool a comment."""
    tool, names = path.program.current, ", ".join(path.program.operations)
    label = _words(f"{tool.label if tool else path.program.tool}{f': {names}' if names else ''}")
    if tool and not tool.first:
        return f"      # {label}: a further run, with the keys of {tool.changed_as} unless there is a group {tool.name}"
    keys = "\n".join(f"  {line}" for line in TOOL.format(**_tool(path)).splitlines())
    return f"      {path.program.tool}:  # {label}\n{keys}"


def _unsaid(path: Toolpath) -> list[str]:
    """Warnings about a tool that mills, and whose diameter or shape the program does not state."""
    tool = path.program.current
    if not np.any(~path.rapid & ~path.drilling & (path.plane_length > 0.0)):  # it drills
        return []
    if not (tool and tool.diameter):
        name = path.program.tool or "the tool"
        return [f"the program does not state the diameter of {name}: {DIAMETER:g} mm are a guess (tool.diameter_mm)"]
    if tool.shape and not tool.end(tool.diameter / 2):
        advice = "is not stated in full: check stops its program unless tool.type of the cell gives its shape"
        return [f"line {tool.line}: {tool.label}, a {tool.shape}, {advice}"]
    return []


def _module_name(file: str) -> str:
    """A name of a robot program from that of a file."""
    name = re.sub(r"[^A-Z0-9]+", "_", pathlib.Path(file).stem.upper()).strip("_")
    longest_name = 12  # characters of a robot program, so that the name of the tool has room
    return (name if name[:1].isalpha() else f"P_{name}")[:longest_name].rstrip("_")


def _common(file: str, path: Toolpath, stock: Box) -> dict:
    """Values of a cell that do not depend on the tool; a KRL program states no speed of the spindle."""
    program = path.program
    frames = {}
    if program.base_frame:
        frames = {"place": ON_DISPLAY.format(*map(_number, program.base_frame))}
        frames["place_note"] = "[source: the program's $BASE]; compare it with the display of the controller"
    if program.tool_frame:
        frames |= {"mounted": ON_DISPLAY.format(*map(_number, program.tool_frame))}
        frames["tool_note"] = "[source: the program's $TOOL]; compare it with the display of the controller"
    return {
        "name": _module_name(file),
        "spindle_on": "[HALT]" if file.lower().endswith(".src") else "[]",
        "place": ON_DISPLAY.format(*map(_number, _place(stock)), 0.0, 0.0, 0.0),
        **frames,
        "offset": path.program.work_offset or "the work offset",
        "low": _list(1e3 * stock.low),
        "high": _list(1e3 * stock.high),
    }


def _tool(path: Toolpath) -> dict:
    """Values of the keys of a tool."""
    tool, speeds = path.program.current, path.program.spindle_speeds
    speed = abs(speeds[0]) * 30 / math.pi if speeds else 0.0  # [rpm]
    comment = _words(f"[source: comment on {tool.label if tool and tool.label else 'the tool'}]")
    known = bool(tool and tool.diameter)
    teeth, source = _teeth(path)
    unsaid = "yours: the program does not say it"
    return {
        "diameter": _number(_diameter(path)),
        "diameter_source": comment if known else unsaid,
        "end": _end(path, comment),
        "teeth": teeth,
        "teeth_source": source or unsaid,
        "speed": f"# spindle_speed_rpm: {_number(speed)}" if speed else STRAIGHT_TOOL["speed"],
        "speed_source": "[source: the program's S]" if speed else "yours: the program has no S",
    }


def _end(path: Toolpath, source: str) -> str:
    """The lines on the shape of a tool whose end is not flat."""
    tool = path.program.current
    keys = tool.end(_diameter(path) / 2e3) if tool else {}
    shown = [f"type: {keys['type']}"] if keys else []
    shown += [f"corner_radius_mm: {_number(1e3 * keys['corner_radius'])}"] if "corner_radius" in keys else []
    return "".join(f"\n      {line:<35}# {source}" for line in shown)


def _teeth(path: Toolpath) -> tuple[int, str]:
    """Number of teeth and its source; "" where the program does not say it."""
    tool = path.program.current
    if tool and tool.teeth:
        return tool.teeth, "[source: the tool's comment]"
    if path.drilling[~path.rapid].all() or (tool and "drill" in tool.description):
        lips = 2  # of a twist drill
        return lips, "yours: the lips of a twist drill"
    return TEETH, ""


def _diameter(path: Toolpath) -> float:
    """[mm], of the tool, or a usual one."""
    tool = path.program.current
    return 1e3 * tool.diameter if tool and tool.diameter else DIAMETER


def straight_text(robot: str) -> str:
    """The YAML of a cell without a program: a slot along +x."""
    return _aligned(TEMPLATE.format(**STRAIGHT, robot=robot))


def _place(stock: Box) -> list[float]:
    """[mm], on base_link: that of the test piece, for a path far from its zero with the middle of the stock there."""
    near = 0.3  # [m]; a path within this distance of its zero gets the place of the test piece
    if max(np.abs(stock.low[:2]).max(), np.abs(stock.high[:2]).max()) <= near:
        return list(PLACE)
    middle = 1e3 * (stock.low + stock.high)[:2] / 2
    return [PLACE[0] - float(middle[0]), PLACE[1] - float(middle[1]), PLACE[2]]


def _aligned(text: str) -> str:
    """Remarks behind values start in one column where they can."""
    lines = []
    for line in text.splitlines():
        code, mark, remark = line.partition("  # ")
        plain = mark and code.strip() and not code.lstrip().startswith("#")
        lines.append(f"{code.rstrip():<40} # {remark.lstrip()}" if plain else line.rstrip())
    return "\n".join(lines) + "\n"


def _number(value: float) -> str:
    return str(round(float(value), 4) + 0.0)


def _list(values) -> str:
    return "[" + ", ".join(_number(value) for value in values) + "]"


def _quoted(text: str) -> str:
    """A YAML scalar in single quotes."""
    return "'" + text.replace("'", "''") + "'"


def _words(text: str) -> str:
    """Text of a file as a comment: printable and on one line."""
    return "".join(c if c.isprintable() else " " for c in text)[:100]
