"""Runs our own KRL as a controller would, which must know every line: where it goes, how fast, in which order."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

NUMBER = r"-?\d+\.?\d*"
PLACE = rf"\{{X {NUMBER},Y {NUMBER},Z {NUMBER}(,A {NUMBER},B {NUMBER},C {NUMBER})?\}}"  # A, B, C as before if left out
SRC = [r"&ACCESS RVP", r"&REL 1", r"&PARAM EDITMASK = \*", r"DEF [A-Z]\w*\( \)", r";.*", r"BAS\(#INITMOV,0\)",
       r"\$(TOOL|BASE)=\{[XYZABC0-9 ,.-]*\}", r"\$(TOOL|BASE)=(TOOL|BASE)_DATA\[\d+\]", r"\$IPO_MODE=#BASE",
       r"\$ORI_TYPE=#VAR", r"\$CIRC_TYPE=#BASE", r"\$ADVANCE=3", rf"\$APO\.CDIS={NUMBER}",
       rf"\$(ACC|JERK)\.CP={NUMBER}", rf"\$(VEL|ACC)\.ORI[12]={NUMBER}", r"BAS\(#VEL_PTP,\d+\)",
       r"\$LOAD=\{M .*,CM \{X .*\}\}", r"PTP X(HOME|APPROACH)", r"LIN XRETRACT", r"WAIT SEC \d+\.\d", r"HALT",
       r"\$OUT\[\d+\]=(TRUE|FALSE)", r"[A-Z]\w*\( \)", r"SPLINE", r"ENDSPLINE",
       rf"SPL {PLACE}( WITH \$VEL\.CP={NUMBER})?", rf"\$VEL\.CP={NUMBER}", r"LIN XP\d+", r"END",
       rf"(LIN |CIRC {PLACE},){PLACE}( C_DIS)?"]  # fmt: skip
DAT = [*SRC[:3], r"DEFDAT [A-Z]\w*", r";.*", r"EXT BAS \(BAS_COMMAND :IN,REAL :IN\)",
       rf"DECL FRAME XP\d+=\{{X {NUMBER},Y {NUMBER},Z {NUMBER},A {NUMBER},B {NUMBER},C {NUMBER}\}}",
       r"DECL FRAME XRETRACT=\{X .*\}", r"DECL E6AXIS XHOME=\{A1 .*,E6 0.0\}",
       r"DECL E6POS XAPPROACH=\{X .*,S \d+,T \d+,E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0\}", r"ENDDAT"]  # fmt: skip


def matrix(frame) -> np.ndarray:
    """KUKA frame X, Y, Z [mm], A, B, C [deg] as a transform [m]: turns about z, y', x''."""
    t = np.eye(4)
    t[:3, 3] = np.array(frame[:3]) * 1e-3
    t[:3, :3] = Rotation.from_euler("ZYX", frame[3:], degrees=True).as_matrix()
    return t


def values(text: str) -> dict[str, float]:
    return {name: float(value) for name, value in (item.split() for item in text.split(","))}


class Robot:
    """Runs a main module and notes where it goes, how fast, and where it comes to rest; points have their order."""

    def __init__(self, directory: Path, main: str):
        self.directory, self.points, self.rests, self.state = directory, [], [], {}
        self.steps: list[str] = []  # every line of the main module and what it calls, in the order of execution
        self.starts: list[int] = []  # points to which a part of the program begins
        self.auxiliary: list[int] = []  # points that are the auxiliary ones of arcs, in their order
        self.comments: list[tuple[int, int]] = []  # number that a comment gives the next point, and its order
        self.run(main)

    def run(self, module: str) -> None:
        (path,) = self.directory.rglob(f"{module}.src")
        text = path.read_bytes().decode("ascii")
        assert text.endswith("END\r\n") and "\n" not in text.replace("\r\n", "")
        starts = self.data(path.with_suffix(".dat")) if path.with_suffix(".dat").exists() else {}
        in_block = False
        for line in text.splitlines():
            assert any(re.fullmatch(pattern, line) for pattern in SRC), line
            self.steps.append(line)
            if match := re.fullmatch(r"(\$[\w.]+)=(.*)", line):
                self.state[match[1]] = match[2]
            elif match := re.fullmatch(r"([A-Z]\w*)\( \)", line):
                self.run(match[1])
            elif match := re.match(r"; XP(\d+)", line):
                self.comments.append((int(match[1]), len(self.points)))
            elif line.partition(" ")[0] in ("SPLINE", "ENDSPLINE"):
                assert in_block == (line == "ENDSPLINE")
                in_block = not in_block
                if not in_block:
                    self.rests.append(len(self.points))
            elif match := re.fullmatch(r"LIN (XP\d+)", line):
                if self.points:  # a later part begins where the tool was
                    assert starts[match[1]] == pytest.approx(self.points[-1][0], abs=1e-4)
                else:
                    self.points.append((starts[match[1]], 0.0))
                self.starts.append(len(self.points))
            elif match := re.fullmatch(r"(LIN|SPL|CIRC) (?:\{(.*)\},)?\{(.*)\}(.*)", line):
                speed = float(match[4].partition("=")[2] or self.state["$VEL.CP"])
                assert in_block == (match[1] == "SPL")
                assert (match[1] == "CIRC") == bool(match[2])
                if match[2]:
                    self.auxiliary.append(len(self.points))
                    self.points.append((self.points[-1][0] | values(match[2]), speed))
                self.points.append((self.points[-1][0] | values(match[3]), speed))
                if match[1] != "SPL" and not match[4]:
                    self.rests.append(len(self.points))

    def matrix(self, name: str) -> np.ndarray:
        """$TOOL or $BASE as a transform [m]."""
        return matrix([float(v) for v in re.findall(rf"[XYZABC] ({NUMBER})", self.state[f"${name}"])])

    @property
    def transforms(self) -> np.ndarray:
        """Of the points in $BASE [m], (n, 4, 4)."""
        return np.array([matrix([frame[key] for key in "XYZABC"]) for frame, _ in self.points])

    def data(self, path: Path) -> dict[str, dict[str, float]]:
        """The name of the first point of a part -> its frame."""
        starts = {}
        for line in path.read_bytes().decode("ascii").splitlines():
            assert any(re.fullmatch(pattern, line) for pattern in DAT), line
            if match := re.search(rf"XAPPROACH={{X ({NUMBER}),Y ({NUMBER}),Z ({NUMBER}).*,S (\d+),T (\d+)", line):
                self.approach = [float(v) for v in match.groups()[:3]]
                self.status, self.turn = int(match[4]), int(match[5])
            if match := re.match(r"DECL FRAME (XP\d+)=\{(.*)\}", line):
                starts[match[1]] = values(match[2])
        return starts

    def column(self, keys: str) -> np.ndarray:
        return np.array([[frame[key] for key in keys] for frame, _ in self.points])
