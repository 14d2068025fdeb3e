"""Findings: kind, place, value and limit of each violation, with advice.

``KINDS`` describes every check once. Checks make a finding of each stretch that violates a limit; ``gathered`` joins
those of a kind and adds their places. Terminal, JSON, report and manifest print the same findings.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from kr270_milling.base.column import column
from kr270_milling.cell.paths import CellPath
from kr270_milling.path.trajectory import Trajectory

DEG = 180.0 / math.pi
EXCEEDS = " exceeds {limit:.4g} {unit} ({where}): {value:.4g} {unit} at point {point}"
SEVERITIES = ("stop", "warning", "note")  #: the worst first; "stop": must not be run


#: unit of a finding -> factor from SI
SCALES = {"mm": 1e3, "um": 1e6, "mm3": 1e9, "deg": DEG, "deg/s": DEG, "deg/s^2": DEG, "%": 100.0, "kW": 1e-3,
          "m/min": 60.0, "urad/(N m)": 1e6, "N/mm2": 1e-6, "rpm": 30.0 / math.pi}  # fmt: skip


@dataclass(frozen=True)
class Kind:
    """A check. The sentence is a format string with the keys that ``violation`` names; empty: the check gives it."""

    unit: str  #: unit of the shown value and limit
    sentence: str
    advice: str
    severity: str = "stop"


KINDS = {
    "reach": Kind("m",
        "out of reach at {where}: the wrist centre would be {value:.4f} m from axis 2 at point {point}, but the arm "
        "reaches from {least:.4f} to {limit:.4f} m",
        "Move the workpiece nearer to the arm, or turn the tool."),
    "joint limit": Kind("deg",
        "{subject} leaves its range of {low:g} to {high:g} deg at {where}: {value:.3f} deg at point {point}",
        "Move or turn the workpiece, or choose another branch by posture_hint_deg."),
    "singularity": Kind("",
        "near the {subject} singularity at {where}: {measure:.4g} {of} at point {point}, at least {wanted:.4g} is "
        "wanted",
        "Move the workpiece, or tilt the mount so that the wrist stays bent."),
    "configuration flip": Kind("",
        "the configuration flips between points {before} and {point}: status S {limit:.0f} becomes {value:.0f}",
        "Move the workpiece until the arm keeps its configuration along the path."),
    "joint speed": Kind("deg/s", "the speed of {axis}" + EXCEEDS,
        "Lower the feed there, or keep away from the singularity."),
    "joint acceleration": Kind("deg/s^2", "the acceleration of {axis}" + EXCEEDS,
        "Lower timing.acceleration_m_per_s2, or round the corner."),
    "load reversal": Kind("um",
        "the load on {subject} reverses at point {point}, beyond {friction_n_m:.3g} N m of friction: if {subject} has "
        "{arcsec:.3g} arcsec of backlash{source}, the tool jumps by {value:.3g} um",
        "Measure arm.backlash_arcsec, or lower the acceleration there.", "note"),
    "correction size": Kind("um",
        "the correction exceeds {limit:.1f} um ({where}): {value:.1f} um at point {point}",
        "Check compliances and force law; then raise compensation.max_correction_mm."),
    "correction per tick": Kind("um", "the change of the correction per tick" + EXCEEDS,
        "Use method inverse, or raise compensation.max_change_per_tick_mm."),
    "correction limited": Kind("um", "",
        "Lower the feed there, or raise the limit in section compensation.", "warning"),
    "written program": Kind("um",
        "the written program leaves {value:.3g} um, the plan {limit:.3g} um (largest deviation across the feed)",
        "Use SPLINE motions, a larger program.line_limit or a smaller program.tolerance_um.", "warning"),
    "corner blending": Kind("%", "the share of the correction that corner blending takes" + EXCEEDS,
        "Lower program.blend_distance_mm, or use SPLINE motions.", "warning"),
    "no blending": Kind("",
        "the robot stops at each of {value:.0f} points of LIN motions, the plan at {limit:.0f}: its times do not hold",
        "Raise program.blend_distance_mm above 0, or use SPLINE motions.", "warning"),
    "spindle torque": Kind("N m", "the spindle torque" + EXCEEDS, "Lower depth, width or feed of the cut."),
    "spindle speed": Kind("rpm", "the spindle is to run at {value:.5g} rpm, more than its {limit:.5g} rpm",
        "Check S, or state the speed of the spindle as limits.spindle_speed_rpm."),
    "spindle power": Kind("kW", "the spindle power" + EXCEEDS, "Lower depth, width, feed or speed of the cut."),
    "stock missed": Kind("mm3", "the path removes nothing from the stock", "Check datum, unit and stock."),
    "rapid in material": Kind("mm",
        "a rapid move goes {length_mm:.4g} mm through material, {value:.4g} mm deep at point {point}, and removes "
        "{volume_mm3:.4g} mm3",
        "Retract above the stock before the rapid move, or feed there (G1)."),
    "below the stock": Kind("mm", "the tool is {value:.4g} mm below {level} at point {point}",
        "Raise the path or lower the stock's bottom; limits.below_stock_mm states a plate under the stock, "
        "workpiece.table_z_mm a lower table."),
    "undercut": Kind("%",
        "{value:.2g} % of the removed volume was above the leaning tool, more than {limit:g} %: the height map has no "
        "material there, so that the forces are bounds",
        "Cut with the tool leaning into the feed, or turn the workpiece so that the tool is upright.", "warning"),
    "holder unknown": Kind("1",
        "the tool is tilted by {degrees:.3g} deg, and tool.stick_out_mm is unknown: the holder is not compared with "
        "workpiece and fixtures",
        "Give tool.stick_out_mm, and tool.holder_mm for more than a slim chuck.", "warning"),
    "in the fixture": Kind("mm", "the {body} enters {subject} at point {point}, {value:.4g} mm below its top",
        "Move the fixture or the path."),
    "depth of cut": Kind("mm", "the cut is {value:.4g} mm deep at point {point}, the flutes are {limit:.4g} mm",
        "Mill in more levels, or take a tool with a longer flute."),
    "plunge": Kind("mm",
        "the {part} {value:.4g} mm into material at point {point}, but it is not centre-cutting{most}",
        "Let the CAM enter by a flatter ramp, a wider helix or from outside, or take a centre-cutting tool."),
    "link contact": Kind("mm",
        "{body} enters {subject} by {value:.4g} mm at point {point}, by capsules within simple solids of the size of "
        "the links, which are no maker's shapes",
        "Move the workpiece or the obstacle, turn the tool, or choose another branch by posture_hint_deg."),
    "tool body": Kind("mm",
        "the {subject} of the tool is {value:.4g} mm deep in material at point {point}: {need} {value:.4g} mm more",
        "Check tool.flute_length_mm, tool.shank_diameter_mm, tool.stick_out_mm and tool.holder_mm; take a longer tool "
        "or a wider way."),
    "tool bending": Kind("N/mm2", "the bending stress of the tool" + EXCEEDS,
        "Lower feed, depth or width of the cut, or take a shorter or thicker tool."),
    "feed per tooth": Kind("mm",
        "{value:.4g} mm a tooth at point {point}, where {limit:.4g} mm is the limit {source}{cause}",
        "Check the unit of F (G20: inch, G95: a revolution, seconds or minutes), S and the number of teeth."),
    "cutting speed": Kind("m/min", "the teeth run at {value:.4g} m/min, but the cutter takes {limit:.4g}",
        "Lower the spindle speed."),
    "chatter": Kind("mm",
        "{subject}: a cut {value:.3g} mm deep at point {point} is {words} of {limit:.3g} mm, chatter at {hertz:.4g} Hz",
        "Lower the depth of cut, or move to a stable spindle speed (kr270_milling stability)."),
    "growing vibration": Kind("1",
        "vibration grows in the simulated pass at point {point}: {percent:.2g} % of the feed per tooth remain from "
        "tooth to tooth",
        "Lower the depth of cut, or move to a stable spindle speed (kr270_milling stability)."),
    "remaining vibration": Kind("1",
        "{percent:.2g} % of the feed per tooth remain from tooth to tooth in the simulated pass at point {point}, "
        "where the depth of cut is less than 80 % of its stability limit",
        "Lower stock.grid_step_um: noise of the grid then becomes smaller.", "note"),
    "exchange": Kind("%",
        "the largest correction of a predicted pose is {value:.1f} % of the {scale} at point {point}, more than "
        "{limit:g} %: the simulated pass says nothing",
        "Use a shorter exchange period or more exchange.iterations."),
    "deflection": Kind("mm", "", "Check force law, feed per tooth, compliances and masses."),
    "joint deflection": Kind("deg", "", "Check compliances and masses; the linear springs do not hold so far."),
    "load on the arm": Kind("1", "", "Check masses and compliances: the arm does not bear its own weight."),
    "tool and grid": Kind("mm", "the grid step of {value:.4g} mm is coarse for a cutter of {diameter:.4g} mm diameter",
        "Check tool.diameter_mm, or lower stock.grid_step_um.", "warning"),
    "envelope": Kind("m", "the workpiece is {value:.4g} m from axis 1, the arm reaches {limit:.4g} m",
        "Check workpiece.xyz_mm and its unit: it is on base_link, in mm.", "warning"),
    "workpiece direction": Kind("deg",
        "z of the workpiece points {value:.4g} deg away from straight up: the tool mills from below",
        "Compare $BASE with BASE_DATA on the display of the controller; copy it to workpiece.base_kuka.", "warning"),
    "compliance": Kind("urad/(N m)",
        "joint {number} deflects by {value:.3g} urad/(N m), arms of this size by 0.01 to 100",
        "Check arm.joint_compliance and its unit, urad per N m.", "warning"),
    "mass": Kind("kg", "link {number} has {value:.3g} kg, links of arms of this size 1 to 2000 kg",
        "Check arm.link_mass_kg and mount.mass_kg.", "warning"),
    "payload": Kind("kg", "mount.mass_kg is {value:.4g} kg, but the arm carries arm.payload_kg, {limit:.4g} kg",
        "Check mount.mass_kg and its unit, or take a lighter spindle."),
    "spindle direction": Kind("deg",
        "the spindle points {value:.4g} deg away from the axis of the flange{words}",
        "Compare $TOOL with TOOL_DATA on the display of the controller; copy it to mount.tool_kuka.", "warning"),
    "tool tip": Kind("mm", "the tip of the tool is {value:.4g} mm {words}",
        "Compare $TOOL with TOOL_DATA on the display of the controller; copy it to mount.tool_kuka.", "warning"),
    "safe height": Kind("mm",
        "the robot program comes from home and leaves by a PTP motion {value:.4g} mm {words}, at least {limit:.4g} mm "
        "are wanted",
        "Raise program.safe_height_mm, in mm above the top of the stock.", "warning"),
    "loose limit": Kind("1", "{key} is {value:.4g}, and its default {limit:.4g} finds more",
        "Leave the key out, or look at what the default finds before you run the program.", "warning"),
    "slowed": Kind("s",
        "the limits of the joints slow the path down: it takes {value:.4g} s, at the programmed feeds {limit:.4g} s",
        "Check arm.joint_speed_limit_deg_per_s and arm.joint_acceleration_limit_deg_per_s, keep away from "
        "singularities, or lower the feed.", "warning"),
    "frame of the program": Kind("mm",
        "{name} of the program is {value:.4g} mm and {degrees:.3g} deg away from {key}",
        "Compare both with the display of the controller; the corrected program sets that of the cell.", "warning"),
    "force coefficient": Kind("N/mm2",
        "K_tc is {value:.4g} N/mm2, but published coefficients, with a margin of three, lie between {low:.4g} and "
        "{high:.4g} N/mm2",
        "Check the unit of cutting.linear_edge; a material of your own gets a row in config/materials.csv."),
    "tool diameter": Kind("mm", "tool.diameter_mm is {value:.6g} mm, but the program is for {label}, {limit:.6g} mm",
        "Set tool.diameter_mm, or post the program for this cutter."),
    "tool shape": Kind("mm",
        "the program is for {label}, {article} {shape}, but floors and forces are those of a flat end mill",
        "Set tool.type to its shape: ball, bull_nose with corner_radius_mm, tapered with taper_deg, or points with "
        "profile_mm; flat if the cutter is flat and the comment is wrong."),
    "stability not judged": Kind("1",
        "stability is not judged: the limits of the depth of cut hold for upright flat ends, and {shape}",
        "Listen to the first cut; lower the depth of cut where the part shows marks of chatter.", "warning"),
    "tool length": Kind("mm",
        "the length of {label} is unknown: the program has no G43 for it, and its mount.xyz_mm is that of an earlier "
        "tool, {tip}",
        "Give each tool its own tip, as tools.T2.mount.xyz_mm.", "warning"),
    "cutter radius": Kind("mm",
        "G41 or G42 moves the path by {value:.6g} mm, the radius in the comment on {label}",
        "A program posted for wear is the path of the centre already: state G10 L12 P1 R0, or post without G41.",
        "warning"),
    "no tool": Kind("1", "the program cuts with {label}, which is an empty spindle",
        "Write the number of the tool, from 1 on, where the program changes to it."),
    "block skip": Kind("1", "", "Leave the switch off: the program without these lines is not checked.", "warning"),
    "cycle heights": Kind("1", "",
        "Other controls run it in another way: begin the cycle again there, with R and Z and the tool above R.",
        "warning"),
    "feed unit": Kind("1", "", "Other controls count it in the new unit: write F in the lines after G20 or G21.",
        "warning"),
    "home sideways": Kind("mm",
        "the move home of {axes} leaves sideways {value:.4g} mm below the top of the stock; the robot program goes up "
        "before it, other controls do not",
        "Retract along Z alone first.", "warning"),
    "two diameters": Kind("1", "", "The first counts: give each tool its own number.", "warning"),
    "no unit": Kind("1", "", "Compare a length with the part; write its unit in the first line.", "warning"),
    "parameter unit": Kind("1", "", "LinuxCNC counts it in the unit of the machine: write a number, or post in mm.",
        "warning"),
    "length number": Kind("1", "", "A control adds the length of another tool: write the H of the tool, or check that "
        "both have the same length.", "warning"),
    "length end": Kind("1", "", "A control may move down by the length: write G49 after G28 or G53.", "warning"),
    "spindle off": Kind("rpm",
        "the program never starts the spindle (S with M3 or M4, SPINDL), and program.spindle_on of the cell is empty",
        "Start it in the program or by program.spindle_on; HALT there lets the operator start it by hand."),
    "drilling": Kind("1", "drilling: force not modelled ({number}); deviations, decision and correction leave drilling "
        "out",
        "Check the thrust of the drill against the arm by hand.", "note"),
    "outside the stock": Kind("mm", "{subject} cuts nothing: its path stays {value:.4g} mm or more beside the stock",
        "Check datum, unit and stock.min_mm, stock.max_mm."),
    "stock too small": Kind("%",
        "{value:.3g} % of the cutting moves are beside the stock, more than {limit:.3g} %",
        "Check datum, unit and stock.min_mm, stock.max_mm.", "warning"),
    "posture": Kind("deg", "{key}: {reason}", "Give the posture within the limits of the arm, in degrees.", "warning"),
}  # fmt: skip


@dataclass(frozen=True)
class Place:
    """Place of a finding; None where it belongs to no point of the path."""

    point: int | None = None  #: number in the robot program, from 1
    line: int | None = None  #: in the file of the tool path
    feature: str | None = None  #: feature of the part
    position_mm: tuple[float, float, float] | None = None  #: place of the tool tip, workpiece frame
    called: str | None = None  #: file and line of a sub-program that ``line`` calls, such as "O7.nc, line 3"


@dataclass(frozen=True)
class Finding:
    """A stretch of points that violates a limit, or all such stretches of one kind, named by the worst of them."""

    severity: str = column("severity")
    what: str = column("what")  #: key of ``KINDS``
    where: Place = column("where")
    value: float = column("value")  #: at the worst place, in ``unit``
    limit: float = column("limit")
    unit: str = column("unit")
    advice: str = column("advice")
    sentence: str = column("sentence")
    count: int = column("count")  #: stretches
    amounts: dict[str, float] = column("amounts")  #: more numbers of the sentence, units in their names
    subject: str = column("", default="")  #: which axis or singularity, if the kind concerns one of several
    block: int | None = column("", default=None)  #: block of the tool path; None: that of the point

    @property
    def text(self) -> str:
        """Return one line, as every output prints it."""
        times = "" if self.count == 1 else f", and {self.count - 1} more of the kind"
        called = f": {self.where.called}" if self.where.called else ""
        line = "" if self.where.line is None else f" (line {self.where.line}{called})"
        return f"{self.sentence}{line}{times}. {self.advice}"


def violation(
    kind: str,
    value: float,
    limit: float,
    point: int | None = None,
    *,
    severity: str = "",
    sentence: str = "",
    subject: str = "",
    block: int | None = None,
    line: int | None = None,
    amounts: dict[str, float] | None = None,
    **words,
) -> Finding:
    """Return a finding; value and limit in SI units; severity, sentence: default those of the kind.

    point: the worst one; block: of the tool path, default: the block that leads to the point; line: of the program;
    amounts: further numbers of the sentence, with their units in their names; words: what else it names.
    """
    known, amounts = KINDS[kind], amounts or {}
    scale = SCALES.get(known.unit, 1.0)
    value, limit = float(value) * scale, float(limit) * scale
    sentence = sentence or known.sentence.format(
        value=value, limit=limit, unit=known.unit, point=point, subject=subject, **amounts, **words
    )
    severity, where = severity or known.severity, Place(point, line or None)
    return Finding(severity, kind, where, value, limit, known.unit, known.advice, sentence, 1, amounts, subject, block)


def violations(
    kind: str,
    value: np.ndarray,
    limit,
    over: np.ndarray | None = None,
    *,
    worst: np.ndarray | None = None,
    points: np.ndarray | None = None,
    **words,
) -> list[Finding]:
    """Return a finding for each stretch of True in ``over`` (n,), named by its worst place.

    value (n,) and limit, a number or (n,): of the places in SI units. over: default: value above limit, or NaN; worst
    (n,): is largest at the worst place, default: value, NaN the worst; points (n,): of the program, default 1 to n;
    words: as for ``violation``, arrays (n,) by place.
    """
    value = np.asarray(value, float)
    limits = np.broadcast_to(limit, len(value))
    rounding = 1e-5  # share of a limit that a value may lie above it: what was cut down to the limit is not beyond it
    over = ~(value <= limits * (1 + rounding)) if over is None else over
    if not over.any():
        return []
    points = np.arange(1, len(value) + 1) if points is None else points
    worst = np.where(np.isnan(value), np.inf, value) if worst is None else worst
    results = []
    for start, stop in stretches(over):
        k = start + int(np.argmax(worst[start:stop]))
        first, last = int(points[start]), int(points[stop - 1])
        where = f"point {first}" if first == last else f"points {first} to {last}"
        sentences = {name: word[k] if isinstance(word, np.ndarray) else word for name, word in words.items()}
        results.append(violation(kind, value[k], limits[k], int(points[k]), where=where, **sentences))
    return results


def stretches(flags: np.ndarray) -> list[list[int]]:
    """[first, stop) of each stretch of True in flags (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return edges.reshape(-1, 2).tolist()


def gathered(path: CellPath, run: Trajectory, results: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return one finding for all of a kind, severity and subject, with its place; the worst severity first."""
    groups: dict[tuple[str, str, str], list[Finding]] = {}
    for result in results:
        groups.setdefault((result.severity, result.what, result.subject), []).append(result)
    findings = []
    for group in groups.values():
        worst = max(group, key=lambda f: np.inf if np.isnan(f.value) else abs(f.value - f.limit))
        findings.append(replace(placed(path, run, worst), count=len(group)))
    return tuple(sorted(findings, key=lambda f: (SEVERITIES.index(f.severity), f.where.point or 0)))


def placed(path: CellPath, run: Trajectory, finding: Finding) -> Finding:
    """Return a finding with the place of its point, of a block without a point, or of its line."""
    fed, point, block = path.fed, finding.where.point, finding.block
    if point is not None:
        position = run.position[min(point, len(run)) - 1]
    elif fed is not None and block is not None:
        position = fed.toolpath.position[block]
    else:
        return finding
    x, y, z = (1e3 * v for v in position.tolist())
    if fed is None:
        return replace(finding, where=Place(point, None, None, (x, y, z)))
    if block is None:  # the block that leads to the point; where two blocks meet, the block that ends there
        ends, distance = np.cumsum(fed.toolpath.block_length), fed.distance[min(point or 1, len(fed.distance)) - 1]
        same_place = 1e-9  # [m], rounding of distances along a path
        block = int(np.clip(np.searchsorted(ends, distance - same_place), 1, len(ends) - 1))
    blocks = fed.toolpath
    line, feature = int(blocks.line[block]), blocks.features[int(blocks.feature[block])]
    called = blocks.program.places[int(blocks.place[block])]
    return replace(finding, where=Place(point, line or None, feature or None, (x, y, z), called or None))
