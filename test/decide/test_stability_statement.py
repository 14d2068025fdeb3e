"""The statement about chatter: depth of cut against the limit of arm, tool and spindle, the same in every output."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from samples.small_part import assignments, small_part
from semi_discretisation import BENCHMARK, directional, limit

from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.models import path_of
from kr270_milling.decide import stability
from kr270_milling.decide.arcs import arcs_along
from kr270_milling.decide.check import check
from kr270_milling.decide.check_cut import residue_of
from kr270_milling.decide.height_map import height_map, lower_along, on_map
from kr270_milling.decide.stability import FEWEST_TEETH, modes_of, stability_statement
from kr270_milling.physics.cutting import Stock
from kr270_milling.studies.maps.lobes import lobes

#: an arm that chatters: one light mode across the feed
SOFT = (
    "dynamics.modes=[{frequency_hz: 60, damping_ratio: 0.02, shape: [0.0, 0.2, 0.0, 0.0, 0.0, 0.0]}]",
    "dynamics.reference_inertia=false", "stock.grid_step_um=20", "path.length_mm=20",
    "tool.spindle_speed_rpm=800", "path.feed_rate_m_per_min=0.4", "exchange.period_ms=0.625",  # teeth at 53 Hz
)  # fmt: skip
RPM = 9000
#: a tool of two teeth with one mode along the feed, on an arm without a mode near it
TOOL_MODE = (*BENCHMARK, f"tool.spindle_speed_rpm={RPM}", "path.length_mm=20", "stock.grid_step_um=50")
UNKNOWN = "tool and spindle: unknown (no tool.modes)"
#: half a cutter of 20 mm in the stock along its edge y = -14, z 0.5 mm deep
EDGE = "G21 G90 S8000 M3\nG0 X{0} Y-14 Z2\nG0 Z-0.5\nG1 X{1} F4000\nG0 Z5\nM30\n"


def cell_of(depth: float, settings):
    return read_cell(find_file("paper.yaml"), [*settings, f"path.depth_of_cut_mm={depth * 1e3}"])


# --- against the limit ---
@pytest.fixture(scope="module")
def slot_limit() -> float:
    """The limit of the benchmark in a full slot [m] by first-order semi-discretisation."""
    depths = np.geomspace(1e-4, 6e-3, 30)
    return limit(60.0 / RPM / 2, directional("slot", 40), directional("slot", 100), depths)[0]


@pytest.mark.parametrize(
    ("share", "word", "severity"),
    [(1.1, "chatter", "stop"), (0.9, "near the limit", "warning"), (0.7, "stable", None)],
)
def test_a_cut_above_the_limit_of_the_tool_is_a_stop_and_just_below_a_warning(share, word, severity, slot_limit):
    checked = check(cell_of(share * slot_limit, TOOL_MODE))
    result = [f for f in checked.findings if f.what == "chatter"]
    assert checked.stability.word == word and [f.severity for f in result] == ([severity] if severity else [])
    assert checked.may_be_run == (severity != "stop")
    worst = checked.stability.worst
    assert worst.depth == pytest.approx(share * slot_limit, rel=1e-6)
    assert worst.limit.depth_limit == pytest.approx(slot_limit, rel=0.02)
    for finding in result:
        assert finding.limit == pytest.approx(1e3 * worst.limit.depth_limit) and finding.where.point
        assert f"{worst.limit.chatter_frequency / 2 / np.pi:.4g} Hz" in finding.sentence
    assert checked.residue.word != "grows"  # the simulated pass has no tool modes: it cannot see this chatter


def test_without_tool_modes_the_statement_is_about_the_arm_alone():
    result = stability_statement(read_cell(find_file("paper.yaml")))
    assert result.text.startswith("stability: arm: stable (straight cut: 0.547 mm, limit above 100 mm, teeth in cut")
    assert result.text.endswith(UNKNOWN) and not result.with_tool


@pytest.fixture(scope="module")
def piece():
    """The test piece with its tool modes, and its statement."""
    cell = read_cell(find_file("test_piece_tool_modes.yaml"))
    return cell, stability_statement(cell)


def test_the_shipped_cell_with_tool_modes_is_stable_and_chatters_when_its_modes_are_ten_times_softer(piece, tmp_path):
    _, result = piece
    assert result.with_tool and result.word == "stable" and len(result.features) == 5
    assert result.text.startswith("stability: arm, tool and spindle: stable (square: 1.2 mm, limit ")
    words = assignments(tmp_path, EDGE.format(-14, 54).replace("Y-14", "Y0").replace("Z-0.5", "Z-1.2"))
    cell = read_cell(find_file("test_piece_tool_modes.yaml"), words)  # a slot as deep as the cuts of the test piece
    softer = cell.tool.replace(modes=cell.tool.modes.replace(mass=cell.tool.modes.mass / 10))
    result = stability_statement(cell.replace(tool=softer))
    assert result.word == "chatter" and result.worst.limit.chatter_frequency > 2 * np.pi * 900


# --- the engagement along the path ---
@pytest.mark.parametrize("ends", [(-14, 54), (54, -14)])
@pytest.mark.parametrize(("rotation", "word"), [("clockwise", "M3"), ("counterclockwise", "M4")])
@pytest.mark.parametrize("immersion", [0.1, 0.25, 0.5, 0.75])
def test_a_cut_along_an_edge_is_engaged_over_its_width_on_the_side_with_material(
    tmp_path, rotation, word, ends, immersion
):
    program = EDGE.format(*ends).replace("Y-14", f"Y{-24 + 20 * immersion:g}").replace("M3", word)
    arcs = arcs_along(path_of(small_part(tmp_path, program, f"tool.rotation={rotation}")))
    steady = (arcs.position[:, 0] > 10e-3) & (arcs.position[:, 0] < 30e-3)
    angle = np.degrees(np.arcsin(2 * immersion - 1))  # [Altintas2012]: up-milling ends where the width is used up
    up = (ends[0] < ends[1]) == (word == "M3")  # a tooth then enters with a chip of 0
    expected = (-90.0, angle) if up else (-angle, 90.0)
    angles = np.degrees(np.column_stack([arcs.entry, arcs.exit])[steady])
    np.testing.assert_allclose(angles, np.tile(expected, (len(angles), 1)), atol=0.5)  # the map: R / 50
    np.testing.assert_allclose(arcs.depth[steady], 0.5e-3, rtol=1e-6)
    assert len(angles) > 40


def test_a_second_way_through_the_same_slot_and_a_rapid_are_no_engagement(tmp_path):
    program = "G21 G90 S8000 M3\nG0 X-14 Y0 Z2\nG0 Z-0.5\nG1 X26 F4000\n{}G0 Z5\nM30\n"
    once, again = (
        arcs_along(path_of(small_part(tmp_path, program.format(more)))) for more in ("", "G1 X-14\nG1 X26\nG0 X-14\n")
    )
    assert abs(len(once.depth) - len(again.depth)) <= 3 and len(once.depth) > 80  # of some 300 places


def test_no_other_engagement_of_a_feature_is_nearer_to_its_limit(piece):
    cell, statement = piece
    square, arcs = next(one for one in statement.features if one.name == "square"), arcs_along(path_of(cell))
    shortest = FEWEST_TEETH * path_of(cell).feed_rate / (8000 / 60 * 4)
    groups = stability._groups(arcs, shortest)
    first = [int(rows[0]) for key, rows in groups.items() if arcs.features[key[0]] == "square"]
    ratios = [stability._limit_at(cell, True, arcs, k)[0] / arcs.depth[k] for k in first]
    assert len(ratios) > 10
    assert square.limit.depth_limit / square.depth == pytest.approx(min(ratios), rel=1e-3)


# --- the simulated pass, with the modes of the arm alone ---
def pass_with(cell, across):
    """A pass whose tool swings by ``across`` (teeth,) [m] at the ends of the tooth periods."""
    period = 2 * np.pi / (cell.tool.spindle_speed * cell.tool.teeth)
    teeth = np.arange(across.size)
    time_ns = np.round(1e9 * period * np.arange(0, across.size - 1, 0.125)).astype(np.int64)
    swing = np.interp(time_ns * 1e-9, teeth * period, across)
    deflection = np.zeros((time_ns.size, 6))
    deflection[:, 1] = swing
    return SimpleNamespace(
        time_ns=time_ns, time=time_ns * 1e-9, deflection=deflection, volume=np.ones(time_ns.size), every=1
    )


def test_noise_and_a_swing_that_dies_out_are_no_growth_but_what_grows_or_lasts_at_any_place_is():
    cell = read_cell(find_file("paper.yaml"))
    feed_per_tooth = path_of(cell).feed_rate * 2 * np.pi / (cell.tool.spindle_speed * cell.tool.teeth)
    n = np.arange(600)
    flip = feed_per_tooth * (-1.0) ** n
    noise = 0.05 * flip * np.random.default_rng(0).normal(size=600)
    lasts = np.where((n > 300) & (n < 400), 0.3, 0.02)
    for swing, word in (
        (noise, "repeats"),
        (noise + flip * 0.5 * 0.9 ** (n % 200), "repeats"),  # after each of three corners
        (noise / 10 + flip * 0.2 * np.exp((n - 600) / 100), "grows"),
        (noise / 10 + flip * lasts, "grows"),  # in one corner
    ):
        residue = residue_of(cell, pass_with(cell, swing))
        assert residue.word == word, (residue, swing)
    residue = residue_of(cell, pass_with(cell, flip * lasts))
    assert 300 < residue.time / feed_per_tooth * path_of(cell).feed_rate < 400  # teeth
    unequal = cell.replace(tool=cell.tool.replace(pitch=np.radians([85, 95, 85, 95])))
    assert (
        residue_of(unequal, pass_with(cell, np.resize(0.5 * feed_per_tooth * np.array([1, -1, 0, 1]), 600))).word
        == "repeats"
    )


def test_vibration_of_the_arm_grows_in_the_pass_above_the_limit_and_a_short_pass_has_no_statement():
    for pitch in ((), ("tool.pitch_deg=[80,95,87,98]",)):
        cell = cell_of(1e-3, (*SOFT, *pitch))
        (lobe,) = lobes(path_of(cell), cell.cutting, modes_of(cell), [cell.tool.spindle_speed])
        for share, word in ((0.5, "repeats"), (2.5, "grows")):
            checked = check(cell_of(share * lobe.depth_limit, (*SOFT, *pitch)))
            limits = [f.limit for f in checked.findings if (f.what, f.severity) == ("growing vibration", "stop")]
            assert checked.residue.word == word and limits == [0.15] * (word == "grows")
            assert checked.stability.word == ("chatter" if word == "grows" else "stable")
    thin = {"path.feed_rate_m_per_min": 0.1, "stock.grid_step_um": 10, "path.length_mm": 6}
    rest = [setting for setting in SOFT if setting.partition("=")[0] not in thin]
    for share, word in ((0.5, "repeats"), (2.5, "grows")):  # a short slot, 31 um a tooth
        settings = *rest, *(f"{key}={value}" for key, value in thin.items()), "tool.pitch_deg=[80,95,87,98]"
        short = cell_of(share * lobe.depth_limit, settings)
        assert residue_of(short, simulate(short).result).word == word
    cell = read_cell(find_file("paper.yaml"))
    whole = simulate(cell).result
    assert residue_of(cell, whole).word == "repeats"
    arrays = {key: value[:200] for key, value in vars(whole).items() if isinstance(value, np.ndarray)}
    result = residue_of(cell, dataclasses.replace(whole, **arrays))
    assert result.word == "no statement" and np.isnan(result.residue) and "no cut of" in result.text


def test_a_long_straight_move_leaves_the_map_of_its_short_parts():
    rng, stock = np.random.default_rng(3), Stock(min=np.array([0.0, 0.0, -5e-3]), max=np.array([0.04, 0.04, 0.0]))
    for _ in range(20):
        ends = np.column_stack([rng.uniform(0.0, 0.04, (6, 2)), rng.uniform(-2e-3, 0.0, 6)])
        share = np.linspace(0.0, 1.0, 400, endpoint=False)[:, None]
        short = np.concatenate([a + share * (b - a) for a, b in zip(ends[:-1], ends[1:], strict=True)])
        radius = float(rng.uniform(0.5e-3, 6e-3))
        grids = [height_map(stock, 2e-4, ends, radius) for _ in range(2)]
        for grid, places in zip(grids, (ends, np.vstack([short, ends[-1:]])), strict=True):
            lower_along(grid, radius, on_map(places))
        assert np.allclose(grids[0].depth, grids[1].depth, rtol=0.0, atol=3e-7)
