"""Learn from a measured part: closed forms, coverage, places that contradict, the former program, and the command."""

import dataclasses

import numpy as np
import pytest
from hostile import printed, settings
from samples.milled_part import SETTINGS, SLOT, small_cell
from scipy.stats import binom

from kr270_milling.base.errors import InputError, ParameterError
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.models import path_of
from kr270_milling.cell.plant import coarser, numbers_of, perturbed, robot_of
from kr270_milling.decide import compensation
from kr270_milling.studies.identification import measured_part as parts
from kr270_milling.studies.identification.wall import PredictedPlaces, WallPlaces, read_wall, robot_errors

UM = 1e-6
#: a cell that knows all but the wear of its tool: 1 to 2 times all forces
KNOWN = (
    "joint_compliance", "force_coefficient", "base_compliance_urad_per_n_m", "tool_stick_out", "tool_compliance",
    "damping_ratio", "frequency", "repeatability_um", "servo_delay_ms", "joining", "placement_mm", "backlash",
)  # fmt: skip
FEW = [
    *(f"uncertainty.{key}=0.0" for key in KNOWN), "uncertainty.end_share=[]", "uncertainty.servo_frequency_hz=[]",
    "uncertainty.tool_wear=1.0", "cutting.detail=engagement",
]  # fmt: skip


def table(n: int = 12, error: float = 0.0, floors: int = 0) -> WallPlaces:
    """Places around a square of 20 mm, the last ones on its floor."""
    turn = 2 * np.pi * np.arange(n) / n
    place = 1e-2 * np.clip(1.4 * np.column_stack([np.cos(turn), np.sin(turn)]), -1.0, 1.0)
    floor = np.arange(n) >= n - floors
    return WallPlaces("made.csv", tuple(range(2, n + 2)), place, np.full(n, np.nan), np.full(n, error),
                      np.full(n, 5 * UM), floor)  # fmt: skip


def test_the_update_is_that_of_the_information_form():
    """P'^-1 = P^-1 + J^T R^-1 J, m' = m + P' J^T R^-1 r."""
    rng = np.random.default_rng(1)
    root, slopes, noise = rng.normal(size=(4, 4)), rng.normal(size=(7, 4)), np.diag(rng.uniform(0.1, 2.0, 7))
    mean, rest, spread = rng.normal(size=4), rng.normal(size=7), root @ root.T
    after, left = parts.gaussian_update(mean, spread, slopes, rest, noise)
    inverse = np.linalg.inv(np.linalg.inv(spread) + slopes.T @ np.linalg.solve(noise, slopes))
    np.testing.assert_allclose(left, inverse, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(after, mean + inverse @ slopes.T @ np.linalg.solve(noise, rest), rtol=1e-8)


def test_the_linear_map_of_a_linear_plant_is_its_own_and_an_unknown_without_effect_gets_none():
    """Six numbers of which four show, 20 places, jumps of 10 um; the map of many robots is that of the plant."""
    rng, n, k = np.random.default_rng(2), 6, 20
    slopes = 20 * UM * rng.normal(size=(k, n)) * (np.arange(n) < 4)
    drawn = rng.normal(size=(4000, n))
    rows = 7 * UM + drawn @ slopes.T + 10 * UM * rng.normal(size=(len(drawn), k))
    offset, fitted, jumps = parts.linear_map(drawn, rows, np.zeros((k, n)), 1.0)
    np.testing.assert_allclose(offset, 7 * UM, atol=1 * UM)
    np.testing.assert_allclose(fitted, slopes, atol=1 * UM)
    np.testing.assert_allclose(np.diag(jumps), (10 * UM) ** 2, rtol=0.15)
    few = parts.linear_map(drawn[:32], rows[:32], np.zeros((k, n)), 1.0)[1]
    assert np.linalg.norm(few[:, 4:]) < 0.5 * np.linalg.norm(np.linalg.lstsq(drawn[:32], rows[:32], rcond=None)[0][4:])


def test_the_band_of_a_plant_with_jumps_contains_ninety_percent_of_the_truths():
    """40 truths with 6 numbers each, 20 places, 64 robots; four standard deviations of the binomial distribution."""
    rng, n, k, hits = np.random.default_rng(2), 6, 20, 0
    slopes, noise = 20 * UM * rng.normal(size=(k, n)), np.diag(np.full(k, (10 * UM) ** 2))

    def errors(numbers):
        return numbers @ slopes.T + 15 * UM * np.sign(np.sin(7 * numbers @ rows_of_jumps))

    rows_of_jumps = rng.normal(size=(n, k))
    for _ in range(40):
        truth, drawn = rng.normal(size=n), rng.normal(size=(64, n))
        measured = errors(truth[None])[0] + 10 * UM * rng.normal(size=k)
        offset, fitted, jumps = parts.linear_map(drawn, errors(drawn), np.zeros((k, n)), 1.0)
        mean, left = parts.gaussian_update(np.zeros(n), np.eye(n), fitted, measured - offset, noise + jumps)
        hits += int(np.sum(np.abs(mean - truth) <= 1.645 * np.sqrt(np.diag(left))))
    assert abs(hits - 0.9 * 40 * n) < 4 * binom.std(40 * n, 0.9)


def robots_of(errors: np.ndarray, seed: int = 3) -> np.ndarray:
    """64 robots whose errors are those of the middle robot times 0.5 to 1.5, and 10 um of their own."""
    rng = np.random.default_rng(seed)
    return errors * rng.uniform(0.5, 1.5, (64, 1)) + 10 * UM * rng.normal(size=(64, errors.size))


@pytest.mark.parametrize(("wrong", "words"), [
    (lambda e, _: -e, "has the opposite sign"),
    (lambda e, _: 1e-3 * e, "is in mm"),
    (lambda e, _: e / 25.4, "is in thousandths of an inch"),
    (lambda e, part: np.where(~part.floor & (part.place[:, 0] > 9e-3), -e, e),
     "at the largest x_mm have the opposite sign"),
    (lambda e, part: np.where(part.floor, -e, e), "of the floor have the opposite sign"),
])  # fmt: skip
def test_another_sign_unit_or_side_is_named_and_a_sound_table_is_not_refused(wrong, words):
    part, rng = table(20, floors=4), np.random.default_rng(4)
    errors = np.where(part.floor, 60 * UM, 100 * UM) * np.linspace(0.8, 1.2, 20)
    rows, noise = robots_of(errors), np.diag(np.full(20, (7 * UM) ** 2))
    for _ in range(20):
        sound = errors * rng.uniform(0.5, 1.5) + 12 * UM * rng.normal(size=20)
        parts.refuse_contradictions([(part, None, "")], sound, rows, noise)
    bad = dataclasses.replace(part, error=wrong(sound, part))
    with pytest.raises(InputError, match=words):
        parts.refuse_contradictions([(bad, None, "")], bad.error, rows, noise)


def test_a_place_that_contradicts_the_others_is_left_out_many_are_refused_and_a_stretch_is_none():
    rest, part = 5 * UM * np.random.default_rng(5).normal(size=20), table(20)
    covariance = (80 * UM) ** 2 + np.diag(np.full(20, (7 * UM) ** 2))  # the robots differ by a constant
    measured = rest + 60 * UM
    measured[7] = -measured[7]
    places = dataclasses.replace(part, error=measured)
    agreeing, sentences = parts.strange_places([(places, None, "")], measured, covariance)
    assert np.flatnonzero(~agreeing).tolist() == [7] and "made.csv, line 9:" in sentences[0]
    assert "it would fit if it has the opposite sign" in sentences[0]
    stretch = dataclasses.replace(part, error=np.where(np.arange(20) < 3, 160 * UM, 60 * UM))
    assert parts.strange_places([(stretch, None, "")], stretch.error, covariance)[0].all()
    measured[7] = -measured[7]
    measured[::4] = -measured[::4]
    with pytest.raises(InputError, match="places contradict the others or the program"):
        parts.strange_places([(places, None, "")], measured, covariance)


# --- A part of a simulated robot ---
@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return small_cell(tmp_path_factory.mktemp("slot"), SLOT, *FEW)


@pytest.fixture(scope="module")
def measured(cell):
    """Twelve places of two parts of a hidden robot whose tool is worn to 1.6 times the forces."""
    place = np.array([(x, y) for x in np.linspace(-6, 12, 4) for y in (-5, 5)] + [(x, 0) for x in (-9, -3, 3, 9)])
    n = len(place)
    places = WallPlaces("made.csv", tuple(range(2, n + 2)), 1e-3 * place, np.full(n, np.nan), np.zeros(n),
                        np.full(n, 1 * UM), np.arange(n) >= 8)  # fmt: skip
    model, rng = coarser(cell), np.random.default_rng(6)
    law = model.cutting.active.grown(1.6)
    hidden = model.replace(cutting=model.cutting.replace(**{model.cutting.law: law}))
    (errors,) = robot_errors([hidden], model, [(None, PredictedPlaces(model, places))])
    return [dataclasses.replace(places, error=errors + UM * rng.normal(size=n)) for _ in range(2)]


def test_a_robot_is_the_numbers_behind_it(cell):
    """Even numbers: the wear is the largest one times the normal distribution function; 0 is the middle."""

    def wear(robot) -> float:
        return robot.cutting.active.tangential_edge / cell.cutting.active.tangential_edge - 1.0

    count = numbers_of(cell)
    assert wear(robot_of(cell, np.zeros(count))) == pytest.approx(0.5)
    learned = cell.uncertainty.replace(
        learned_from=("part",), learned=np.full(count, 0.5), learned_directions=np.eye(count).ravel()
    )
    certain = cell.replace(uncertainty=learned)
    drawn = perturbed(certain, np.random.default_rng(1))
    assert wear(drawn) == pytest.approx(0.6914625, rel=1e-6)  # tables of the distribution
    other = certain.replace(uncertainty=learned.replace(servo_frequency=np.array([10.0, 40.0])))
    with pytest.raises(ParameterError, match="uncertainty.learned"):
        perturbed(other, np.random.default_rng(1))


def test_the_wear_of_the_tool_is_learned_within_its_band_and_a_second_part_narrows_it(cell, measured):
    first = parts.learn(cell, [(measured[0], path_of(cell).target, "wall.csv")])
    second = parts.learn(first.cell, [(measured[1], path_of(cell).target, "wall2.csv")])
    widths = []
    for learned in (first, second):
        (row,) = (row for row in learned.rows if row["name"] == "tangential edge")
        assert abs(row["mean"] - 1.6) < 3 * row["sigma"] < 3 * row["sigma_before"] and not learned.left_out
        widths.append(row["sigma"])
    # errors are in proportion to the forces: 10 % error of the model are 0.16 of 1.6 times the forces
    assert widths[1] < widths[0] < 1.1 * 0.16
    assert any(line.startswith("learned: tangential edge: 1.") for line in first.lines())
    assert second.cell.uncertainty.learned_from == ("wall.csv", "wall2.csv")


def test_a_program_stays_where_the_robots_gain_less_than_a_tenth(cell, monkeypatch):
    monkeypatch.setattr(compensation, "PLANNED", 2)
    target = path_of(cell).target
    worse = target.with_position(target.position + np.array([0.0, 500 * UM, 0.0]), target.velocity)
    assert compensation.better_program(cell, target, worse)[0] is target
    assert "no gain of 10 %" in compensation.better_program(cell, target, target)[1]
    assert compensation.better_program(cell, worse, target) == (target, "")
    other = target.with_position(target.position + np.array([0.0, -500 * UM, 0.0]), target.velocity)
    assert "as programmed is better" in compensation.better_program(cell, worse, other)[1]


def test_the_command_learns_keeps_its_result_in_a_file_and_refuses_what_it_cannot_use(
    cell, measured, tmp_path, capsys, monkeypatch, few_robots
):
    monkeypatch.setattr(parts, "ROUNDS", ((32, 1.0), (24, 20.0)))  # the test before has all
    first = measured[0]
    rows = zip(1e3 * first.place, 1e6 * first.error, first.floor, strict=True)
    lines = [f"{x},{y},{e:.2f},1,{'floor' if floor else ''}" for (x, y), e, floor in rows]
    wall = tmp_path / "wall.csv"
    wall.write_text("\n".join(["x_mm,y_mm,error_um,sigma_um,surface", *lines]))
    small_cell(tmp_path, SLOT, *FEW)
    sets = settings(*SETTINGS, f"path.file={tmp_path / 'path.nc'}", *FEW)
    words = ["compensate", "test_piece.yaml", "--verdict", "0", "--out", str(tmp_path / "out"), *sets]
    _, text, values, _ = printed(capsys, *words, "--measured", str(wall))
    assert "learned: tangential" in text and "learned.yaml in the cell (includes)" in text
    assert values["method"] in ("robust", "former", "as_programmed")
    (tmp_path / "with.yaml").write_text(
        f'/**:\n  ros__parameters:\n    includes: ["test_piece.yaml", "{tmp_path}/out/learned.yaml"]\n'
    )
    again = read_cell(tmp_path / "with.yaml", [*SETTINGS, f"path.file={tmp_path / 'path.nc'}", *FEW])
    assert again.uncertainty.learned.size == numbers_of(again)
    assert again.uncertainty.learned_from[0].startswith("wall.csv, 12 places, as programmed")
    wall.write_text("\n".join(["x_mm,y_mm,error_um,sigma_um,surface", *lines[:5]]))
    for more, words_of_error in (
        (["--measured", str(wall)], "has 5 places, but a measured part needs 6 to 200"),
        (["--reference", str(wall)], "--reference: is given 1 times, but --measured 0 times"),
    ):
        with pytest.raises(InputError, match=words_of_error):
            printed(capsys, *words, *more)
    wall.write_text("x_mm,y_mm,error_um,surface\n" + "0,5,1,side\n" * 6)
    with pytest.raises(InputError, match="surface must be one of wall, floor"):
        read_wall(wall)
