"""All checks of one cell, and of a corrected trajectory in it."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from kr270_milling.base.errors import InputError
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass, simulate
from kr270_milling.decision.check_arm import arm_findings
from kr270_milling.decision.check_cut import cut_findings
from kr270_milling.trajectory.limits import Finding, corner_blending, correction_per_tick, correction_size
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["Checked", "check"]

SEVERITIES = ("stop", "warning", "note")


@dataclass(frozen=True, eq=False)
class Checked:
    """What was found, the worst first; lines of the tool path file where there is one."""

    findings: tuple[Finding, ...]
    lines: tuple[int | None, ...]
    points: int
    ran: ScoredPass | None  #: the pass that was simulated, if the arm can make it

    @property
    def stops(self) -> bool:
        """Whether the path must not be run."""
        return any(f.severity == "stop" for f in self.findings)

    def count(self, severity: str) -> int:
        return sum(f.severity == severity for f in self.findings)

    def sentences(self) -> list[str]:
        """One for each finding, with its line."""
        pairs = zip(self.findings, self.lines, strict=True)
        return [f.sentence + ("" if line is None else f" (line {line})") for f, line in pairs]

    def as_dict(self) -> dict:
        """For JSON; values and limits in SI units."""
        rows = [asdict(f) | {"line": line} for f, line in zip(self.findings, self.lines, strict=True)]
        return {
            "may_be_run": not self.stops,
            "points": self.points,
            **{f"{severity}s": self.count(severity) for severity in SEVERITIES},
            "findings": rows,
        }


def check(
    cell: Cell, reference: Trajectory | None = None, motion: str | None = None, ran: ScoredPass | None = None,
    progress=None,
) -> Checked:  # fmt: skip
    """Check the cell's own path, or a corrected one; motion: LIN or SPLINE.

    Default: LIN for a correction in straight lines of a smooth path, as compensate writes it, else that of ``program``.

    ran: the pass along it, if it was simulated already. Where the arm cannot make the path, nothing is simulated.
    Raises InputError for a path that cannot be read or misses the stock, and for a reference of another path.
    """
    fed = cell.fed_path
    programmed = cell.target() if fed is None else fed.trajectory
    run = programmed if reference is None else reference
    found, joints = arm_findings(cell, run)
    reachable = joints is not None and not any(f.kind == "joint limit" for f in found)
    if reachable and reference is None and fed is not None:
        run = cell.target()  # slowed down to what the joints can do
        found, _ = arm_findings(cell, run)
    if reachable:
        target = cell.target()
        straight = run.velocity is None and target.velocity is not None
        found += _correction(cell, target, run, motion or ("LIN" if straight else cell.program.motion))
        if ran is None:
            ran = simulate(cell, run, "checked", progress)
        found += cut_findings(cell, run, ran)
    found = sorted(found, key=lambda f: (SEVERITIES.index(f.severity), f.point))
    return Checked(tuple(found), _lines(cell, found), len(run), ran if reachable else None)


def _correction(cell: Cell, target: Trajectory, run: Trajectory, motion: str) -> list[Finding]:
    if not np.array_equal(target.time_ns, run.time_ns):
        raise InputError("reference", f"its times are not those of the {len(target)} points of this cell's path")
    if run is target:
        return []
    how = cell.compensation
    found = correction_size(target, run, how.tick_ns, how.max_correction + 1e-8)
    found += correction_per_tick(target, run, how.tick_ns, how.max_change_per_tick + 1e-9)
    if motion == "LIN":
        found += corner_blending(target, run, cell.program.blend_distance, cell.limits.blending_share)
    return found


def _lines(cell: Cell, found: list[Finding]) -> tuple[int | None, ...]:
    fed = cell.fed_path
    if fed is None:
        return (None,) * len(found)
    points = np.clip([f.point - 1 for f in found], 0, len(fed.block) - 1).astype(int)
    return tuple(line or None for line in fed.toolpath.line[fed.block[points]].tolist()) if found else ()
