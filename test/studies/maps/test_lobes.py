"""Stability lobes against published and independent limits; symmetries; order of convergence."""

from types import SimpleNamespace

import numpy as np
import pytest
from budget import LONG
from hostile import answered, refused, settings
from samples.small_part import small_part
from scipy.optimize import brentq
from semi_discretisation import BENCHMARK, MASS, TEETH, directional, limit, modal_radius, radius

from kr270_milling.base.errors import ConfigError, ParameterError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.models import path_of
from kr270_milling.decide.stability import feature_limits, modes_of
from kr270_milling.physics.motion.stability import Modes, stability_limit
from kr270_milling.studies.maps.lobes import lobes

RPM = np.pi / 30.0


def benchmark(immersion: float = 1.0, mode: str = "slot"):
    return read_cell(find_file("paper.yaml"), [*BENCHMARK, f"path.radial_immersion={immersion}", f"path.mode={mode}"])


def limits_at(cell, speeds):
    """Limits of a cell, without the modes of the arm."""
    return lobes(path_of(cell), cell.cutting, modes_of(cell, arm=False), speeds)


CUTS, SPEEDS = ((1.0, "slot"), (0.5, "up"), (0.5, "down")), (5000, 9000, 13500, 20000)
PAIRS = [(*cut, speed) for k, speed in enumerate(SPEEDS) for n, cut in enumerate(CUTS) if LONG or k % 3 == n]


@pytest.mark.parametrize(("immersion", "mode", "speed"), PAIRS)
def test_limit_and_frequency_are_those_of_semi_discretisation(immersion, mode, speed):
    delay = 60.0 / speed / TEETH
    depths = np.geomspace(1e-4, 6e-3, 30)
    expected, multiplier = limit(delay, directional(mode, 40), directional(mode, 160), depths)
    (result,) = limits_at(benchmark(immersion, mode), [speed * RPM])
    assert result.depth_limit == pytest.approx(expected, rel=0.01)
    beat = abs(np.angle(multiplier))
    assert abs(np.angle(np.exp(1j * result.chatter_frequency * delay))) == pytest.approx(beat, abs=0.03)


def test_an_unstable_island_below_the_lobe_is_the_limit():
    """Half immersion, down, 10,000 rpm: vibration of twice the tooth period grows from 2.106 to 2.345 mm."""
    delay, h = 60.0 / 10000 / TEETH, directional("down", 100)
    first = brentq(lambda depth: radius(depth, delay, h) - 1.0, 2.0e-3, 2.2e-3)
    (result,) = limits_at(benchmark(0.5, "down"), [10000 * RPM])
    assert result.depth_limit == pytest.approx(first, rel=2e-3)
    assert result.chatter_frequency * delay / np.pi % 2.0 == pytest.approx(1.0, abs=1e-9)


def random_loop(rng, unequal=False):
    """Tool and arm modes, cut and speed of a random mill, and dF / du of the teeth over each interval of a period."""
    of_arm = np.arange(rng.integers(1, 4 if unequal else 11)) > 3  # four modes of the tool, then of the arm
    hertz, ratio, mass = (
        np.exp(rng.uniform(*np.log(np.where(of_arm[:, None], arm, tool)).T))
        for tool, arm in (((200, 2500), (8, 250)), ((0.005, 0.06), (0.01, 0.06)), ((0.03, 2), (50, 400)))
    )
    shape = rng.normal(size=(hertz.size, 3))
    modes = Modes(2 * np.pi * hertz, ratio, shape / np.linalg.norm(shape, axis=1, keepdims=True) / mass[:, None] ** 0.5)
    teeth = int(rng.integers(2, 5) if unequal else rng.integers(1, 7))
    delay = rng.uniform(0.3, 3.0) / hertz.max()
    arc = np.arccos(1.0 - 2.0 * np.exp(rng.uniform(np.log(0.02), 0.0)))
    entry = (-np.pi / 2, np.pi / 2 - arc, -arc / 2)[rng.integers(3)]
    k_t = rng.uniform(3e8, 25e8)
    stiffness = k_t * np.array([1.0, rng.uniform(0.1, 0.6), rng.uniform(-0.3, 0.3)])
    k = int(max(60, 40 * delay * hertz.max(), 24 * 2 * np.pi / teeth / arc))  # 24 intervals on the arc
    lags = np.full(teeth, k)
    if unequal:
        lags[:-1] += rng.integers(-k // 8, k // 8 + 1, teeth - 1)
        lags[-1] = teeth * k - lags[:-1].sum()
    different = teeth if unequal else 1  # the others repeat the first
    fine = (np.arange(200 * k * different) + 0.5) / 200  # intervals
    b = np.zeros((different, k * different, 3, 2))
    for tooth in range(teeth):
        angle = (fine + lags[:tooth].sum()) * 2 * np.pi / teeth / k
        angle = np.mod(angle + np.pi, 2 * np.pi) - np.pi
        cut = (angle > entry) & (angle < entry + arc)
        radial = np.stack([np.cos(angle), -np.sin(angle)], -1)
        motion = np.stack([-np.sin(angle), -np.cos(angle)], -1)
        force = np.column_stack([stiffness[1] * radial + stiffness[0] * motion, np.full(angle.size, stiffness[2])])
        slopes = cut[:, None, None] * force[:, :, None] * radial[:, None]
        b[tooth % different] -= slopes.reshape(k * different, 200, 3, 2).mean(1)
    tool = SimpleNamespace(teeth=teeth, sense=-1.0, pitches=lags * 2 * np.pi / teeth / k)
    cutting = SimpleNamespace(active=SimpleNamespace(slopes=lambda h: tuple(np.outer(stiffness, 1 + 0 * h))))
    return modes, tool, cutting, (entry, entry + arc, 2 * np.pi / teeth / delay), delay * different, lags[:different], b


@pytest.mark.parametrize("unequal", [False, True])
@pytest.mark.parametrize("seed", range(1000 if LONG else 4))
def test_below_the_limit_of_random_modes_every_multiplier_is_within_the_unit_circle_and_above_not(seed, unequal):
    modes, tool, cutting, arc, *loop = random_loop(np.random.default_rng(seed), unequal)
    limit, _ = stability_limit(modes, tool, cutting, 1e-4, *arc)
    deepest = min(limit, 0.1)
    shares = np.append(np.geomspace(0.02, 0.5, 12), np.arange(0.5, 0.98, 0.01 if LONG else 0.04))
    assert all(modal_radius(modes, share * deepest, *loop) < 1.0 + 1e-9 for share in shares)
    assert limit > 0.1 or any(modal_radius(modes, share * limit, *loop) > 1.0 for share in (1.01, 1.02))


def test_a_feature_is_cut_in_its_own_direction(tmp_path):
    """A feed along y meets a mode along y as one along x meets that along x, and another one where modes differ."""
    law = (*BENCHMARK[:-1], "path.mode=up", "path.radial_immersion=0.5")
    along_x = "G21 G90 S8000 M3\nG0 X-14 Y-14 Z2\nG0 Z-0.5\nG1 X54 F4000\nG0 Z5\nM30\n"
    along_y = "G21 G90 S8000 M3\nG0 X40 Y-28 Z2\nG0 Z-0.5\nG1 Y54 F4000\nG0 Z5\nM30\n"

    def limit_of(program, direction):
        cell = small_part(tmp_path, program, *law, BENCHMARK[-1].replace("[1, 0, 0]", direction))
        (result,) = feature_limits(cell, arm=False)
        assert result.depth == pytest.approx(0.5e-3)
        assert np.degrees([result.entry, result.exit]) == pytest.approx([-90.0, 0.0], abs=0.5)
        return result.limit, cell

    with_x, cell = limit_of(along_x, "[1, 0, 0]")
    (expected,) = limits_at(cell, [cell.tool.spindle_speed])
    assert with_x.depth_limit == pytest.approx(expected.depth_limit, rel=0.05)
    assert limit_of(along_y, "[0, 1, 0]")[0].depth_limit == pytest.approx(with_x.depth_limit, rel=0.05)
    assert limit_of(along_x, "[0, 1, 0]")[0].depth_limit != pytest.approx(with_x.depth_limit, rel=0.2)


def test_the_sense_of_rotation_mirrors_and_a_heavier_mode_cuts_deeper():
    cell = benchmark()
    other = cell.replace(tool=cell.tool.replace(rotation="counterclockwise"))
    (one,), (mirrored,) = (limits_at(c, [9000 * RPM]) for c in (cell, other))
    assert mirrored.depth_limit == pytest.approx(one.depth_limit, rel=1e-6)
    heavy = read_cell(find_file("paper.yaml"), [*BENCHMARK[:-1], BENCHMARK[-1].replace(str(MASS), str(2 * MASS))])
    (twice,) = limits_at(heavy, [9000 * RPM])
    assert twice.depth_limit == pytest.approx(2 * one.depth_limit, rel=2e-3)  # m x'' = -a h: only a / m counts


def test_the_command_prints_lobes_and_writes_table_and_picture(tmp_path):
    words = ["stability", "paper.yaml", "--speeds", "8000:10000/3", "--out", tmp_path / "out", *settings(*BENCHMARK)]
    alone = answered(*words, "--no-arm")
    assert [row["spindle_speed_rpm"] for row in alone["lobes"]] == pytest.approx([8000, 9000, 10000])
    assert all(0 < row["depth_limit_mm"] < 10 and row["chatter_hz"] > 500 for row in alone["lobes"])
    table = np.genfromtxt(alone["files"][0], delimiter=",", names=True)
    assert table["depth_limit_mm"] == pytest.approx([row["depth_limit_mm"] for row in alone["lobes"]], rel=1e-4)
    assert (tmp_path / "out" / "lobes.html").exists() and answered(*words)["arm"] and not alone["arm"]


def test_what_cannot_be_meant_is_refused():
    with pytest.raises(ParameterError, match="no mode"):
        limits_at(read_cell(find_file("paper.yaml")), [800.0])
    with pytest.raises(ConfigError, match="direction"):
        read_cell(find_file("paper.yaml"), [BENCHMARK[-1].replace("[1, 0, 0]", "[2, 0, 0]")])
    assert refused("stability", "paper.yaml", "--speeds", "1:2")
    for along in ((), ("--along",)):
        ball = refused("stability", "test_piece.yaml", "--set", "tool.type=ball", *along)
        assert "tool.type is 'ball', but must be flat" in ball
