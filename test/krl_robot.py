"""Runs our own KRL as a controller would, which must know every line: where it goes, how fast, in which order."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

NUMBER = r"-?\d+\.?\d*"
SRC = [r"&ACCESS RVP", r"&REL 1", r"&PARAM EDITMASK = \*", r"DEF [A-Z]\w*\( \)", r";.*", r"BAS\(#INITMOV,0\)",
       r"\$(TOOL|BASE)=\{[XYZABC0-9 ,.-]*\}", r"\$(TOOL|BASE)=(TOOL|BASE)_DATA\[\d+\]", r"\$IPO_MODE=#BASE",
       r"\$ORI_TYPE=#VAR", r"\$ADVANCE=3", rf"\$APO\.CDIS={NUMBER}",
       rf"\$(ACC|JERK)\.CP={NUMBER}", rf"\$(VEL|ACC)\.ORI[12]={NUMBER}", r"BAS\(#VEL_PTP,\d+\)",
       r"\$LOAD=\{M .*,CM \{X .*\}\}", r"PTP X(HOME|APPROACH)", r"LIN XRETRACT", r"WAIT SEC \d+\.\d", r"HALT",
       r"\$OUT\[\d+\]=(TRUE|FALSE)", r"[A-Z]\w*\( \)", rf"SPLINE WITH \$VEL\.CP={NUMBER}", r"ENDSPLINE",
       rf"SPL XP\d+( WITH \$VEL\.CP={NUMBER})?", rf"\$VEL\.CP={NUMBER}", r"LIN XP\d+( C_DIS)?", r"END"]  # fmt: skip
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


class Robot:
    """Runs a main module and notes where it goes, how fast, and where it comes to rest."""

    def __init__(self, directory: Path, main: str):
        self.directory, self.points, self.rests, self.state = directory, [], [], {}
        self.steps: list[str] = []  # every line of the main module and what it calls, in the order of execution
        self.run(main)

    def run(self, module: str) -> None:
        text = (self.directory / f"{module}.src").read_bytes().decode("ascii")
        assert text.endswith("END\r\n") and "\n" not in text.replace("\r\n", "")
        frames = self.data(module)
        in_block = False
        for line in text.splitlines():
            assert any(re.fullmatch(pattern, line) for pattern in SRC), line
            self.steps.append(line)
            if match := re.fullmatch(r"(\$[\w.]+)=(.*)", line):
                self.state[match[1]] = match[2]
            elif match := re.fullmatch(r"([A-Z]\w*)\( \)", line):
                self.run(match[1])
            elif line.partition(" ")[0] in ("SPLINE", "ENDSPLINE"):
                assert in_block == (line == "ENDSPLINE")
                in_block, of_block = not in_block, line.partition("=")[2]
                if not in_block:
                    self.rests.append(self.points[-1][0])
            elif match := re.fullmatch(r"(LIN|SPL) XP(\d+)(.*)", line):
                speed = match[3].partition("=")[2] or (of_block if in_block else self.state.get("$VEL.CP", "0"))
                assert in_block == (match[1] == "SPL")
                self.points.append((int(match[2]), frames[int(match[2])], float(speed)))
                if match[1] == "LIN" and not match[3] and match[2] != "1":  # the approach ends there
                    self.rests.append(int(match[2]))

    def matrix(self, name: str) -> np.ndarray:
        """$TOOL or $BASE as a transform [m]."""
        return matrix([float(v) for v in re.findall(rf"[XYZABC] ({NUMBER})", self.state[f"${name}"])])

    @property
    def transforms(self) -> np.ndarray:
        """Of the points in $BASE [m], (n, 4, 4)."""
        return np.array([matrix([frame[key] for key in "XYZABC"]) for _, frame, _ in self.points])

    def data(self, module: str) -> dict[int, dict[str, float]]:
        text = (self.directory / f"{module}.dat").read_bytes().decode("ascii")
        frames = {}
        for line in text.splitlines():
            assert any(re.fullmatch(pattern, line) for pattern in DAT), line
            if match := re.search(rf"XAPPROACH={{X ({NUMBER}),Y ({NUMBER}),Z ({NUMBER}).*,S (\d+),T (\d+)", line):
                self.approach = [float(v) for v in match.groups()[:3]]
                self.status, self.turn = int(match[4]), int(match[5])
            if match := re.match(r"DECL FRAME XP(\d+)=\{(.*)\}", line):
                frames[int(match[1])] = {k: float(v) for k, v in (item.split() for item in match[2].split(","))}
        return frames

    @property
    def numbers(self) -> np.ndarray:
        return np.array([number for number, _, _ in self.points])

    def column(self, keys: str) -> np.ndarray:
        return np.array([[frame[key] for key in keys] for _, frame, _ in self.points])

    @property
    def time(self) -> np.ndarray:
        """[s] at each point, along straight lines."""
        length = np.linalg.norm(np.diff(self.column("XYZ"), axis=0), axis=1) * 1e-3
        return np.concatenate([[0.0], np.cumsum(length / [speed for _, _, speed in self.points[1:]])])
