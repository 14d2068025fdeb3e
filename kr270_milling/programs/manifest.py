"""The manifest beside the programs: which file goes where, and in which order to try them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from kr270_milling.cell.program import Program

__all__ = ["manifest"]


def manifest(
    place: Path,
    program: Program,
    files: Mapping[str, Sequence[Path]],
    findings: Sequence[str],
    tick_ns: int,
    released: bool,
) -> list[str]:
    """Lines of text; files: paths by kind, below ``place``; tick_ns: of the RSI table."""
    lines = [
        "Files for the controller, written by kr270_milling. A simulation result: verify it on the machine.\n",
        "Names carry method, date and the hash of the corrected trajectory: files of one name belong together.\n",
        "\n",
    ]
    if not released:
        lines += ["NOT RELEASED: the check forbids to run this path. Its programs are for looking at.\n", "\n"]
    for kind, paths in files.items():
        if kind.startswith("krl_"):
            lines += _program(place, program, kind, paths)
    rsi, (first, second), (trajectory,) = files["rsi"][0].name, files["joints"], files["trajectory"]
    lines += [
        f"{rsi}: for RSI on top of the original program.\n",
        f"  time_s: every {tick_ns / 1e6:g} ms from the start of the path, point 1. dX_mm, dY_mm, dZ_mm: correction\n",
        "  along the axes of $BASE, the whole of it, not the step from the tick before. dA_deg, dB_deg, dC_deg: its\n",
        "  turn about z, y', x'' of $BASE.\n",
        f"{first.name}, {second.name}: for a joint trajectory controller, as programmed and corrected.\n",
        "  time_s: from the start of the path. joint_a1_deg to joint_a6_deg: positions, signs as KUKA counts them.\n",
        f"{trajectory.name}: the corrected trajectory for 'simulate --reference' and 'check --reference'.\n",
        "  time_s, then mm, mm/s, deg; qx to qw: orientation of the tool in the workpiece frame.\n",
        "\n",
        "Findings of the check:\n",
        *(f"  {line}\n" for line in findings or ["none were asked for"]),
    ]
    return lines


def _program(place: Path, program: Program, kind: str, paths: Sequence[Path]) -> list[str]:
    folder = paths[0].parent.relative_to(place)
    name, motion = program.name, kind.removeprefix("krl_").upper()
    return [
        f"{folder}: {len(paths)} files, {motion} motions. Copy all of them to KRC:\\R1\\Program on the controller.\n",
        f"  {name}_ORG runs the programmed path, {name}_CMP the corrected one; points have the same numbers.\n",
        "  1. T1, 10 % override, spindle off, the tool well above the part (raise $BASE): ORG, then CMP.\n",
        "  2. T1, 10 %, spindle on, an air cut at the height of the part: CMP.\n",
        "  3. T1 at full height of the part with the spindle on, then AUT with rising override: CMP.\n",
        "\n",
    ]
