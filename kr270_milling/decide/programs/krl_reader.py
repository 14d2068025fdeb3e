"""Read a KRL program of this package back: the points in the order of the motion, and where the robot stops."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kr270_milling.base.errors import InputError
from kr270_milling.base.frames import Pose

__all__ = ["KrlPath", "read_krl"]

CALL = re.compile(r"([A-Z]\w*)\( \)")
MOTION = re.compile(r"(SPL|LIN) XP(\d+)( C_DIS)?(?: WITH .*)?")
LIMIT = re.compile(r"(\$(?:ACC\.CP|JERK\.CP|(?:VEL|ACC)\.ORI[12]))=(.*)")
FRAME = re.compile(r"DECL FRAME XP(\d+)=\{X (.*),Y (.*),Z (.*),A (.*),B (.*),C (.*)\}")


@dataclass(frozen=True, eq=False)
class KrlPath:
    """The path of a main module and of the modules that the main module calls."""

    number: np.ndarray  #: (p,), of the points, from 1
    pose: Pose  #: in $BASE, (p, 3), (p, 3, 3)
    stops: np.ndarray  #: (p,) bool: exact stops; the first point is the end of the approach
    spline: bool  #: SPL motions; else LIN
    limits: dict[str, float]  #: variables of the controller as the program sets them, such as $ACC.CP [m/s2]


def read_krl(directory, main: str) -> KrlPath:
    """Read the modules ``main``.src and .dat; raise InputError for a point without a frame and for mixed motions."""
    numbers: list[int] = []
    frames: list[list[float]] = []
    stops: list[bool] = []
    kinds: set[str] = set()
    limits: dict[str, float] = {}

    def run(module: str) -> None:
        own = _frames(Path(directory, f"{module}.dat"))
        path = Path(directory, f"{module}.src")
        for line in path.read_text(encoding="ascii").splitlines():
            if match := CALL.fullmatch(line):
                run(match[1])
            elif match := LIMIT.fullmatch(line):
                limits[match[1]] = float(match[2])
            elif line == "ENDSPLINE":
                stops[-1] = True
            elif match := MOTION.fullmatch(line):
                number = int(match[2])
                if number not in own:
                    raise InputError(path, f"the point XP{number} has no frame in {module}.dat")
                kinds.update({match[1]} if numbers else ())  # the approach is LIN in both programs
                numbers.append(number)
                frames.append(own[number])
                stops.append(not numbers[1:] or (match[1] == "LIN" and not match[3]))

    run(main)
    if len(kinds) != 1:
        raise InputError(main, "the path must have SPL motions or LIN motions, at least one and not both")
    rows = np.array(frames)
    pose = Pose.from_abc(rows[:, :3] * 1e-3, np.radians(rows[:, 3:]))
    return KrlPath(np.array(numbers), pose, np.array(stops), kinds == {"SPL"}, limits)


def _frames(path: Path) -> dict[int, list[float]]:
    """Number -> X, Y, Z [mm], A, B, C [deg]."""
    matches = map(FRAME.fullmatch, path.read_text(encoding="ascii").splitlines())
    return {int(match[1]): [float(value) for value in match.groups()[1:]] for match in matches if match}
