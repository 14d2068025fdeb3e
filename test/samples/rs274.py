"""The reference interpreter: rs274 of LinuxCNC runs a program, and its moves are compared with ours.

``RS274`` names the program, or it is in PATH; Debian's linuxcnc-uspace contains it, its libraries are in usr/lib of
that package and in libboost-python. ``python rs274.py FILE ...`` compares files, ``python rs274.py COUNT`` that number
of random programs.
"""

from __future__ import annotations

import math
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import NamedTuple

from kr270_milling.base.errors import InputError
from kr270_milling.base.files import read_lines
from kr270_milling.path.cam.gcode.interpreter import Interpreter
from kr270_milling.path.cam.gcode.reader import GcodeReader, changes_by_m6
from kr270_milling.path.cam.program_builder import ProgramBuilder
from kr270_milling.path.source_program import ProgramTool

RS274 = os.environ.get("RS274") or shutil.which("rs274") or ""
NEAR = 3e-3  #: [mm], twice that in inches: rs274 writes four decimals of a place and of each shift
#: diameters are inches here, and D n is a tool of n mm
TOOLS = "".join(f"T{n} P{n} D{n / 25.4:.9f} Z0\n" for n in range(1, 300))
CANON = re.compile(r"^ *\d+ +N[\d.]+ *(\w+)\((.*)\)$")


class Move(NamedTuple):
    """A move of the tool: rapid, straight, arc or spline."""

    kind: str
    end: tuple[float, ...]  #: [mm], NaN: not known
    length: float  #: [mm], NaN for a rapid move
    feed: float  #: [mm/min], NaN for a rapid move
    home: bool = False


def reference(path) -> tuple[list[Move], str]:
    """Return the moves that rs274 writes for a program, and its complaint."""
    library = Path(RS274).resolve().parents[1] / "lib"
    paths = os.pathsep.join(map(str, (library, library / "x86_64-linux-gnu", os.environ.get("LD_LIBRARY_PATH", ""))))
    with tempfile.TemporaryDirectory() as folder:
        table, parameters = Path(folder) / "tool.tbl", Path(folder) / "rs274.var"
        table.write_text(TOOLS)
        command = [RS274, "-g", "-t", str(table), "-v", str(parameters), str(Path(path).resolve())]
        ran = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=60, cwd=Path(path).resolve().parent,
            env=os.environ | {"LD_LIBRARY_PATH": paths, "HOME": folder},  # its tool table is in a file there
        )  # fmt: skip
    harmless = re.compile(r"executing|.*variable file.*|File ended with no percent sign.*|Bad character '%' used|%|")
    complaint = [line for line in ran.stderr.splitlines() if not harmless.fullmatch(line)]
    ended = "File ended with no" in ran.stderr  # its next line is the last one of the program
    return canonical_moves(ran.stdout.splitlines()), "" if ended else " ".join(complaint)


def canonical_moves(lines) -> list[Move]:
    """Return the moves of canonical commands, in machine coordinates."""
    unit, plane, feed, per_revolution = 1.0, 17, 0.0, False
    system, preset, rotation = [0.0] * 3, [0.0] * 3, 0.0
    moves: list[Move] = []
    place: tuple[float, ...] = (0.0, 0.0, 0.0)
    for line in lines:
        match = CANON.match(line)
        if not match:
            continue
        name, rest = match.groups()
        if name == "USE_LENGTH_UNITS":
            unit = {"CANON_UNITS_MM": 1.0, "CANON_UNITS_INCHES": 25.4}[rest]
        elif name == "SELECT_PLANE":
            plane = {"CANON_PLANE_XY": 17, "CANON_PLANE_XZ": 18, "CANON_PLANE_YZ": 19}[rest]
        elif name == "SET_G5X_OFFSET":
            system = [unit * float(value) for value in rest.split(",")[1:4]]
        elif name == "SET_G92_OFFSET":
            preset = [unit * float(value) for value in rest.split(",")[:3]]
        elif name == "SET_XY_ROTATION":
            rotation = float(rest)
        elif name == "SET_FEED_RATE":
            feed = unit * float(rest)
        elif name == "SET_FEED_MODE":
            per_revolution = rest.split(",")[1].strip() == "1"
        elif name == "NURBS_FEED":  # rs274 does not state its points
            place = (math.nan,) * 3
            moves.append(Move("curve", place, math.nan, math.nan))
        elif name in ("STRAIGHT_TRAVERSE", "STRAIGHT_FEED", "ARC_FEED"):
            numbers = [float(value) for value in rest.split(",")]
            rate, turn = math.nan if per_revolution else feed, _turn(rotation)
            if name == "ARC_FEED":
                xy = (complex(*place[:2]) - complex(*system[:2])) / turn - complex(*preset[:2])
                start = xy.real, xy.imag, place[2] - system[2] - preset[2]
                numbers[:4] = [unit * value for value in numbers[:4]]
                end, length = _arc(plane, numbers[:4], int(numbers[4]), unit * numbers[5], start)
            else:
                end, length = [unit * value for value in numbers[:3]], math.nan
            turned = complex(end[0] + preset[0], end[1] + preset[1]) * turn
            whole = turned.real + system[0], turned.imag + system[1], end[2] + preset[2] + system[2]
            if name == "STRAIGHT_FEED":
                length = math.dist(place, whole)
            kind = {"ARC_FEED": "arc", "STRAIGHT_FEED": "straight", "STRAIGHT_TRAVERSE": "rapid"}[name]
            moves.append(Move(kind, whole, length, math.nan if kind == "rapid" else rate))
            place = whole
    return moves


def _turn(degrees: float) -> complex:
    return complex(math.cos(math.radians(degrees)), math.sin(math.radians(degrees)))


def _arc(plane, numbers, rotation: int, across: float, start) -> tuple[list[float], float]:
    first, second, axis = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}[plane]
    end = [0.0] * 3
    end[first], end[second], end[axis] = numbers[0], numbers[1], across
    centre = numbers[2:]
    radius = math.dist((start[first], start[second]), centre)
    last = math.dist((end[first], end[second]), centre)
    angles = [math.atan2(point[second] - centre[1], point[first] - centre[0]) for point in (start, end)]
    sweep = (angles[1] - angles[0]) % (2 * math.pi)
    if rotation < 0:
        sweep = (angles[0] - angles[1]) % (2 * math.pi)
    if math.dist((start[first], start[second]), (end[first], end[second])) < 1e-6 or sweep < 1e-9:
        sweep = 2 * math.pi
    sweep += 2 * math.pi * (abs(rotation) - 1)
    return end, math.hypot(sweep * (radius + last) / 2, end[axis] - start[axis])


class _Logged(Interpreter):
    """Notes each move; starts where rs274 does."""

    watched = True

    def __init__(self, *args):
        super().__init__(*args)
        self.moves: list[Move] = []
        self.position = [0.0] * 3
        self.to_initial = self.fixed = False  # rs274 starts in G99, and G10 sets its offsets
        self.homes = False
        self.radii |= {float(n): 0.5e-3 * n for n in range(1, 300)}

    def go(self, end) -> None:
        super().go(end)
        self.moves.append(Move("rapid", tuple(1e3 * value for value in self.on_path(end)), math.nan, math.nan))

    def _feed_to(self, start, ends, length, curvature=0.0) -> None:
        rate = self._feed_rate(length) or 0.0
        super()._feed_to(start, ends, length, curvature)
        kind = {2: "arc", 3: "arc", 5: "curve", 5.1: "curve", 5.2: "curve"}.get(self.mode or 0, "straight")
        kind = "straight" if self.drilled else kind
        end = tuple(1e3 * value for value in self.on_path(ends[-1]))
        self.moves.append(Move(kind, end, 1e3 * length, math.nan if self.feed_mode == 95 else 6e4 * rate))

    def home(self, axes) -> None:
        super().home(axes)
        self.homes = True
        self.moves.append(Move("home", tuple(1e3 * value for value in self.position), math.nan, math.nan))


def ours(path) -> tuple[list[Move], str, bool]:
    """Return the moves of our interpreter, the sentence of a refusal, and whether the program goes home."""
    program = ProgramBuilder(str(path), "")
    program.known |= {f"T{n}": ProgramTool(f"T{n}", diameter=1e-3 * n) for n in range(1, 300)}
    try:
        lines = read_lines(path)
        machine = _Logged(program, 0.0, changes_by_m6(lines), [0.0] * 27)
        GcodeReader(program, machine).read(lines)
    except InputError as error:
        return [], str(error), False
    refused = [refusal for _, refusal in program._refused]
    return machine.moves, refused[0].sentence if refused else "", machine.homes


def _strokes(moves: list[Move], homes: bool) -> list[tuple[Move, Move]]:
    """Return pairs of moves, the second one cutting or, without a move home, any; moves of no length are left out."""
    rows: list[tuple[Move, Move]] = []
    last = Move("start", (0.0, 0.0, 0.0), math.nan, math.nan)
    for move in moves:
        still = move.length < 1e-6 if move.kind != "rapid" else _near(last.end, move.end, 1e-6) and last.kind != "curve"
        if not still:
            before = rows[-1] if rows and not homes and move.kind == "rapid" == rows[-1][1].kind else None
            if before and _straight_on(before[0].end, last.end, move.end):
                rows[-1] = before[0], move
            elif move.kind != "home" and not (homes and move.kind == "rapid"):
                rows.append((last, move))
            last = move
    return rows


def _straight_on(start, middle, end) -> bool:
    """Return whether the tool continues in the same direction along one axis, as in a cycle."""
    first, second = ([b - a for a, b in zip(*ends, strict=True)] for ends in ((start, middle), (middle, end)))
    steps = ((move, min(NEAR, 0.1 * math.hypot(*move))) for move in (first, second))  # with the rounding across
    axes = {axis for move, least in steps for axis in range(3) if abs(move[axis]) > least}
    return len(axes) == 1 and all(first[axis] * second[axis] > 0 for axis in axes)


def _near(one, other, tolerance: float) -> bool:
    return all(
        not abs(a - b) > tolerance for a, b in zip(one, other, strict=True) if math.isfinite(a) and math.isfinite(b)
    )


def difference(path) -> str:
    """Return "" where ours and rs274 agree, "refused: ..." for a refusal, "rs274: ..." for one of rs274, or how they
    differ."""
    moves, sentence, homes = ours(path)
    if sentence:
        return f"refused: {sentence}"
    theirs, complaint = reference(path)
    if complaint:
        return f"rs274: {complaint}"
    near = NEAR * (2 if "G20" in Path(path).read_text(errors="replace").upper() else 1)
    one, other = _strokes(moves, homes), _strokes(theirs, homes)
    k = n = 0
    while k < len(one) and n < len(other):
        (start, move), (begin, other_move) = one[k], other[n]
        apart = not (_near(start.end, begin.end, near) and _near(move.end, other_move.end, near))
        # the radius of an arc has the rounding of its centre
        longer = abs(move.length - other_move.length) > (8 if move.kind == "arc" else 2) * near + 1e-4 * move.length
        # with G93 LinuxCNC moves at 0.1 mm or inches a minute at least
        faster = abs(move.feed - other_move.feed) > 0.02 + 1e-4 * move.feed and other_move.feed > 2.55
        if not (apart or longer or faster or move.kind != other_move.kind):
            k, n = k + 1, n + 1
        elif move.length < 3 * near or other_move.length < 3 * near:  # rounding may leave nothing of the shorter one
            k, n = (k + 1, n) if move.length < 3 * near else (k, n + 1)
        else:
            return f"differs: move {k}: {move} from {start.end}, rs274 {other_move} from {begin.end}"
    rest = (
        move for start, move in (*one[k:], *other[n:])
        if not (move.length < 3 * near or (move.kind == "rapid" and _near(start.end, move.end, near)))
    )  # fmt: skip
    if more := list(rest):
        return f"differs: {len(one)} moves, rs274 {len(other)}; the first further one is {more[0]}"
    return ""


def random_program(rng: random.Random) -> str:
    """Return a program of moves, arcs, cycles, work offsets, parameters and loops, most of them sound."""
    unit = rng.choice((1.0, 1.0, 25.4))
    lines = ["G21" if unit == 1.0 else "G20", "G90 G17 G94 G91.1 G40 G80 G98", f"F{rng.uniform(100, 900) / unit:.1f}"]
    lines += ["#100=1", "#<_n>=2.5", f"G0 X{_number(rng)} Y{_number(rng)} Z{_number(rng)}"]
    subs = [f"O{100 + k}" for k in range(rng.choice((0, 0, 1, 2)))]
    lines = [line for sub in subs for line in (f"{sub} sub", *_blocks(rng, [], 3), f"{sub} endsub [#1+1]")] + lines
    return "\n".join([*lines, *_blocks(rng, subs, rng.randint(5, 25)), "M2", ""])


def _number(rng: random.Random) -> str:
    """A number, an expression or a parameter; four decimals at most, as rs274 writes them."""
    value = round(rng.uniform(-60, 60), rng.choice((0, 1, 2, 3, 4)))
    if rng.random() < 0.8:
        return f"{value:g}"
    operator, function = rng.choice("+-*"), rng.choice(("SIN", "COS", "ABS", "FIX", "FUP", "ROUND", "ATAN"))
    second = f"{function}[{value:g}]" + ("/[3]" if function == "ATAN" else "")
    return rng.choice((f"[{value:g}{operator}#100]", f"[{second}*7]", "#<_n>", f"[[{value:g} MOD 7]**2/9]", "-#100"))


PLACES = ["G55", "G59.3", "G92 X{} Z{}", "G92.1", "G92.2", "G92.3", "G52 Y{}"]
PLACES += ["G10 L2 P{} X{} Y{}", "G10 L2 P1 R30", "G10 L20 P{} X{}"]
SETTINGS = ["G17", "G18", "G19", "G90", "G91", "G90", "G17", "F200", "#100=[#100+{}]", "#<_n>=[#100/3] #100=#<_n>"]
SETTINGS += ["G21 F300", "G20 F20", "G61", "M8", "G4 P1"]


def _filled(rng: random.Random, text: str) -> str:
    """Put numbers where a text has {}, after P one of a work offset."""
    while "{}" in text:
        before, _, after = text.partition("{}")
        text = before + (f"{rng.randint(0, 3)}" if before[-1] == "P" else _number(rng)) + after
    return text


def _blocks(rng: random.Random, subs: list[str], count: int) -> list[str]:
    """Blocks; those of a condition or a loop together."""
    lines: list[str] = []
    for label in range(count):
        kind = rng.random()
        if kind < 0.35:
            axes = rng.sample("XYZ", rng.randint(1, 3))
            lines.append(rng.choice(("G0", "G1", "G1", "G1")) + "".join(f" {axis}{_number(rng)}" for axis in axes))
        elif kind < 0.6:
            lines += _random_arc(rng)
        elif kind < 0.7:
            lines += _random_cycle(rng)
        elif kind < 0.86:
            lines.append(_filled(rng, rng.choice(PLACES if kind < 0.8 else SETTINGS)))
        elif kind < 0.89:
            lines += _random_contour(rng)
        elif kind < 0.92 and subs:
            lines.append(f"{rng.choice(subs)} call [{_number(rng)}] [2]")
        else:
            inside = [f"G1 X{_number(rng)}", f"G0 Y[#101*{_number(rng)}]", "#101=[#101+1]"]
            name = f"O{label + 10 * count * len(subs) + 1000 + 100 * len(lines)}"
            lines += ["#101=0", *rng.choice((
                [f"{name} while [#101 LT 3]", *inside, f"{name} endwhile"],
                [f"{name} do", *inside, f"{name} while [#101 LE 2]"],
                [f"{name} repeat [2]", *inside, f"{name} endrepeat"],
                [f"{name} if [#100 GT {_number(rng)}]", *inside, f"{name} elseif [#<_n> LE 2]", "G1 Z1", f"{name} else",
                 "G1 Z2", f"{name} endif"],
            ))]  # fmt: skip
    return lines


def _random_arc(rng: random.Random) -> list[str]:
    """An arc about a centre at a whole distance from its start; from a place that the block before it states."""
    plane = rng.choice((17, 17, 17, 18, 19))
    first, second, across = {17: "XYZ", 18: "ZXY", 19: "YZX"}[plane]
    centres = {"X": "I", "Y": "J", "Z": "K"}
    x, y, radius = rng.uniform(-50, 50), rng.uniform(-50, 50), rng.uniform(0.5, 40)
    start, sweep = rng.uniform(0, 6.28), rng.choice((rng.uniform(0.1, 6.2), 2 * math.pi))
    a = x + radius * math.cos(start), y + radius * math.sin(start)
    b = x + radius * math.cos(start + sweep), y + radius * math.sin(start + sweep)
    word = rng.choice((2, 3))
    end = "" if sweep > 6.28 else f" {first}{b[0]:.5f} {second}{b[1]:.5f}"
    helix = rng.choice(("", "", f" {across}{rng.uniform(-9, 9):.3f}"))
    turns = rng.choice(("", "", f" P{rng.randint(1, 3)}"))
    centre = f" {centres[first]}{x - a[0]:.5f} {centres[second]}{y - a[1]:.5f}"
    if end and rng.random() < 0.3:
        centre, turns = f" R{radius * rng.choice((1, -1)):.5f}", ""
    return ["G90", f"G{plane}", f"G1 {first}{a[0]:.5f} {second}{a[1]:.5f}", f"G{word}{end}{helix}{centre}{turns}"]


def _random_contour(rng: random.Random) -> list[str]:
    """A contour with the tool beside it: lines and arcs, corners of any angle, moves along z; often one where the tool
    does not fit."""
    x, y, heading, radius = rng.uniform(-30, 30), rng.uniform(-30, 30), rng.uniform(-180, 180), rng.randint(1, 8)
    lines = ["G90 G17", f"G0 X{x:.4f} Y{y:.4f}", rng.choice((f"G41 D{2 * radius}", f"G42 D{2 * radius}"))]
    timed = rng.random() < 0.2  # each move states its time
    lines += ["G93"] * timed
    feed = "" if timed else " F333"
    for k in range(rng.randint(2, 9)):
        heading += 0 if not k else rng.choice((0, 90, -90, rng.uniform(-170, 170), rng.uniform(-60, 60)))
        way, before = rng.uniform(9, 50), complex(x, y)
        turn = rng.choice((0, 0, 90, -90, rng.uniform(-300, 300))) if k or rng.random() < 0.2 else 0
        chord = 2 * way * math.sin(math.radians(abs(turn) / 2)) or way
        step = chord * _turn(heading + turn / 2)
        x, y = round(x + step.real, 5), round(y + step.imag, 5)
        centre = before + 1j * way * _turn(heading) * (1 if turn > 0 else -1) - before
        word = "G0" if rng.random() < 0.1 and k else "G1" if not turn else "G3" if turn > 0 else "G2"
        arc = f" I{centre.real:.5f} J{centre.imag:.5f}" if word in ("G2", "G3") else ""
        lines.append(f"{word} X{x:.5f} Y{y:.5f}{arc}" + rng.choice(("", "", f" Z{rng.uniform(-3, 3):.3f}", feed)))
        heading += turn if arc else 0
        lines += rng.choice(([], [], [], [f"G1 Z{rng.uniform(-3, 3):.3f}"]))
    step = 2 * radius * _turn(heading)
    if timed:
        lines = [line + f" F{rng.uniform(5, 90):.1f}" * (line[:3] in ("G1 ", "G2 ", "G3 ")) for line in lines]
        lines.append("G94 F444")
    return [*lines, "G40", f"{rng.choice(('G0', 'G1'))} X{x + step.real:.4f} Y{y + step.imag:.4f}"]


def _random_cycle(rng: random.Random) -> list[str]:
    plane = rng.choice((17, 17, 18, 19))
    first, second, across = {17: "XYZ", 18: "ZXY", 19: "YZX"}[plane]
    kind = rng.choice((81, 82, 83, 73, 85, 86, 89))
    level = "G99" if kind in (85, 89) else rng.choice(("G98", "G99"))  # with G98 rs274 feeds out above R
    rest = " Q1.7" if kind in (83, 73) else " P0.1" if kind in (82, 86, 89) else ""
    if rng.random() < 0.3:
        return ["S500 M3 G91", f"G{plane} {level}", f"G{kind} {first}3 {second}1 {across}-4 R1 L3{rest}", "G80", "G90"]
    holes = [f"{first}{_number(rng)}" for _ in range(rng.randint(0, 2))]
    start = rng.choice((70, 90))
    cycle = f"G{kind} {first}1 {second}{_number(rng)} {across}{rng.uniform(-9, 0):.3f} R{rng.choice((2, 75))}{rest}"
    return [f"G90 G{plane} {level}", f"G0 {across}{start}", "S500 M3", cycle, *holes, "G80"]


def main(arguments: list[str]) -> None:
    results: Counter[str] = Counter()
    folder = tempfile.TemporaryDirectory()
    if arguments[0].isdigit():
        paths = (_written(seed, Path(folder.name)) for seed in range(int(arguments[0])))
    else:
        paths = (Path(argument) for argument in arguments)
    for path in paths:
        try:
            result = difference(path)
        except Exception as error:
            result = f"rs274: {type(error).__name__}"
        results[result.partition(":")[0] or "equal"] += 1
        if result:
            print(f"{path}: {result[:400]}", flush=True)
    print(dict(results))


def _written(seed: int, folder: Path) -> Path:
    path = folder / f"random_{seed}.ngc"
    path.write_text(random_program(random.Random(seed)))
    return path


if __name__ == "__main__":
    main(sys.argv[1:])
