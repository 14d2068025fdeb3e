"""Stability lobes against published and independent limits; symmetries; order of convergence."""

from __future__ import annotations

import numpy as np
import pytest
from hostile import answered, refused, settings
from semi_discretisation import BENCHMARK, MASS, OMEGA, TEETH, ZETA, directional, limit
from small_part import small_part

from kr270_milling.base.errors import ConfigError, ParameterError
from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.decide.stability import feature_limits, modes_of
from kr270_milling.physics.motion.monodromy import Modes, directional_matrices, multipliers
from kr270_milling.physics.motion.stability import limit_depth
from kr270_milling.studies.maps.lobes import lobes

RPM = np.pi / 30.0


def benchmark(immersion: float = 1.0, mode: str = "slot"):
    return read_cell(find_file("paper.yaml"), [*BENCHMARK, f"path.radial_immersion={immersion}", f"path.mode={mode}"])


@pytest.mark.parametrize(("immersion", "mode"), [(1.0, "slot"), (0.5, "up"), (0.5, "down")])
@pytest.mark.parametrize("speed", [5000, 9000, 13500, 20000])
def test_limit_and_frequency_are_those_of_semi_discretisation(immersion, mode, speed):
    delay = 60.0 / speed / TEETH
    depths = np.geomspace(1e-4, 6e-3, 30)
    expected, multiplier = limit(delay, directional(mode, 40), directional(mode, 100), depths)
    (result,) = lobes(benchmark(immersion, mode), [speed * RPM], arm=False)
    assert result.depth_limit == pytest.approx(expected, rel=0.01)
    beat = abs(np.angle(multiplier))
    assert abs(np.angle(np.exp(1j * result.chatter_frequency * delay))) == pytest.approx(beat, abs=0.03)


def test_the_limit_converges_with_the_square_of_the_step():
    cell = benchmark(0.5, "up")
    modes, delay = modes_of(cell, arm=False), 60.0 / 9000 / TEETH
    limits = []
    for nodes in (40, 80, 160, 640):
        angles = 0.0, 0.5 * np.pi
        matrices = directional_matrices(lambda s: (6e8 + 0 * s, 2e8 + 0 * s, 0 * s), -1.0, TEETH, *angles, nodes)
        limits.append(limit_depth(modes, matrices, delay)[0])
    errors = np.abs(np.array(limits[:3]) / limits[3] - 1.0)
    assert np.polyfit(np.log([40, 80, 160]), np.log(errors), 1)[0] < -1.6


def test_without_a_cut_the_multipliers_are_those_of_the_free_modes():
    free = Modes(np.array([OMEGA, 3 * OMEGA]), np.array([ZETA, 0.05]), np.array([[1.0, 0, 0], [0, 1.0, 0]]))
    result = multipliers(free, np.zeros((30, 3, 2)), 0.0, 1e-3)
    expected = np.exp(-free.damping_ratio * free.frequency * 1e-3)
    assert np.sort(np.abs(result))[-4:] == pytest.approx(np.sort(np.repeat(expected, 2)), rel=1e-9)


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
    (expected,) = lobes(cell, [cell.tool.spindle_speed], arm=False)
    assert with_x.depth_limit == pytest.approx(expected.depth_limit, rel=0.05)
    assert limit_of(along_y, "[0, 1, 0]")[0].depth_limit == pytest.approx(with_x.depth_limit, rel=0.05)
    assert limit_of(along_x, "[0, 1, 0]")[0].depth_limit != pytest.approx(with_x.depth_limit, rel=0.2)


def test_the_sense_of_rotation_mirrors_and_a_heavier_mode_cuts_deeper():
    cell = benchmark()
    other = cell.replace(tool=cell.tool.replace(rotation="counterclockwise"))
    (one,), (mirrored,) = (lobes(c, [9000 * RPM], arm=False) for c in (cell, other))
    assert mirrored.depth_limit == pytest.approx(one.depth_limit, rel=1e-6)
    heavy = read_cell(find_file("paper.yaml"), [*BENCHMARK[:-1], BENCHMARK[-1].replace(str(MASS), str(2 * MASS))])
    (twice,) = lobes(heavy, [9000 * RPM], arm=False)
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
        lobes(read_cell(find_file("paper.yaml")), [800.0], arm=False)
    with pytest.raises(ConfigError, match="direction"):
        read_cell(find_file("paper.yaml"), [BENCHMARK[-1].replace("[1, 0, 0]", "[2, 0, 0]")])
    assert refused("stability", "paper.yaml", "--speeds", "1:2")
