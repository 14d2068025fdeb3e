"""The command identify, the commands of its page, errors in measurements, a measured wall beside the predicted wall."""

import csv
import dataclasses
import math
import re

import numpy as np
import pages
import pytest
from budget import LONG
from hostile import answered, ask, refused, settings
from samples.campaigns import COEFFICIENTS, TRUE, cuts, loads, measured, measured_cuts

from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.recordings.bag.writer import BagWriter
from kr270_milling.recordings.messages.codec import serialise
from kr270_milling.show.commands.console import Answer
from kr270_milling.studies.identification import compliance
from kr270_milling.studies.identification.forces import Sensor, recorded_mean_force
from kr270_milling.studies.identification.wall import compare_wall, read_wall

WRENCH = "geometry_msgs/msg/WrenchStamped"
RPM, RATE = 6000.0, 2500  # 25 samples a revolution
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # A = 90 deg: sensor axes -> workpiece axes
OFFSET = np.array([12.0, -7.0, 440.0])  # of the sensor: drift and the weight on it [N], sensor axes


def record(directory, forces, rate: float, topic: str = "/plate/wrench") -> None:
    """A recording of forces (n, 3) [N] in the sensor's axes, from 100 s on."""
    with BagWriter(directory) as writer:
        writer.add_topic(topic, WRENCH)
        for k, force in enumerate(forces):
            sec, nanosec = divmod(round(100e9 + k * 1e9 / rate), 10**9)
            vector = dict(zip("xyz", force.tolist(), strict=True))
            fields = {"header": {"stamp": {"sec": sec, "nanosec": nanosec}}, "wrench": {"force": vector}}
            writer.write(topic, serialise(WRENCH, fields), 10**9 + k)


def sensor_recording(directory, force) -> None:
    """A dynamometer under the part: 0.3 s idle, 0.5 s of a cut with four teeth's ripple, 1 % of noise."""
    t = np.arange(int(0.8 * RATE)) / RATE
    share = np.where(t < 0.3, 0.0, 1 + 0.4 * np.sin(4 * 2 * np.pi * RPM / 60 * t))
    noise = np.random.default_rng(3).normal(size=(len(t), 3))
    record(directory, -np.outer(share, force) @ TURN + OFFSET + noise, RATE)


def test_forces_come_out_of_recordings_of_a_plate_under_the_part(tmp_path):
    """Tare from the idle stretch, axes turned by A = 90 deg, signs of the part."""
    some = measured_cuts(cuts(feeds=(0.05e-3, 0.1e-3, 0.2e-3)))
    rows = ["feed_per_tooth_mm,depth_mm,width_mm,mode,recording,start_s,stop_s"]
    for i, (feed, force) in enumerate(zip(some.feed_per_tooth, some.force, strict=True)):
        sensor_recording(tmp_path / f"cut_{i}", force)
        rows.append(f"{1e3 * feed},1,20,slot,cut_{i},0.35,0.75")
    (tmp_path / "cuts.csv").write_text("\n".join(rows) + "\n")
    result = answered(
        "identify", "forces", tmp_path / "cuts.csv", "--teeth", 4, "--diameter-mm", 20, "--topic", "wrench",
        "--spindle-speed-rpm", RPM, "--tare", "0:0.25", "--sensor-abc", "90,0,0", "--sensor-on", "part",
    )  # fmt: skip
    parts = [("cutting_n_per_mm2", 1e6), ("edge_n_per_mm", 1e3)]
    keys = [(f"{side}_{part}", unit) for side in ("tangential", "radial", "axial") for part, unit in parts]
    for (key, unit), true in zip(keys, COEFFICIENTS, strict=True):
        assert abs(result[key] - true / unit) < 2 * result["ci95"][key]
    assert result["ci95"]["tangential_cutting_n_per_mm2"] < 0.02 * result["tangential_cutting_n_per_mm2"]


@pytest.mark.parametrize("on_part", [False, True])
def test_the_weight_on_a_sensor_is_taken_off_where_there_is_no_tare(tmp_path, on_part):
    """20 kg hang on it: 196.133 N down, which a plate under the part feels as a force on the part."""
    force, sign = np.array([10.0, 40.0, -15.0]), -1.0 if on_part else 1.0
    record(tmp_path / "cut", np.tile(sign * force + [0.0, 0.0, -196.133], (250, 1)), RATE)
    sensor = Sensor(on_part=on_part, mass=20.0)
    result, _ = recorded_mean_force(tmp_path / "cut", sensor, (0.02, 0.08), RPM * 2 * math.pi / 60)
    assert result == pytest.approx(force, abs=1e-3)


def test_a_cell_that_places_its_workpiece_by_joints_has_a_tool_for_the_cuts():
    assert "use the linear-edge law" in ask("identify", "forces", "cuts.csv", "--cell", "paper.yaml").out


def test_a_cut_that_the_recording_does_not_hold_is_refused(tmp_path):
    sensor_recording(tmp_path / "cut", np.array([10.0, 20.0, 5.0]))
    table = tmp_path / "cuts.csv"
    words = ("identify", "forces", str(table), "--teeth=4", "--diameter-mm=20", f"--spindle-speed-rpm={RPM}")
    head = "feed_per_tooth_mm,depth_mm,mode,recording,start_s,stop_s\n"
    table.write_text(f"{head}0.1,1,slot,cut,0.6,1.8\n")
    assert "it lasts 0.7996 s" in refused(*words)
    table.write_text(f"{head}0.1,1,slot,cut,0.4,0.7\n")
    assert "it holds /plate/wrench" in refused(*words, "--topic", "force")


def test_a_material_is_listed_and_written_to_be_included(tmp_path):
    assert len(answered("identify", "material")["materials"]) >= 6
    words = ("identify", "material", "al7075-t6", "--row", 2, "--out", tmp_path)
    (file,) = answered(*words)["files"]
    cell = tmp_path / "cell.yaml"
    cell.write_text(f'/**:\n  ros__parameters:\n    includes: ["test_piece.yaml", "{file}"]\n')
    assert read_cell(cell).cutting.linear_edge.tangential_cutting == pytest.approx(767.01e6)


SPRING = "compliance load_tests.csv --arm kr270_2.yaml --cell test_piece.yaml --compensator"


@pytest.mark.parametrize(("words", "reason"), [
    ("compliance --arm kr270_2.yaml", "needs a table of load tests"),
    ("compliance --arm kr270_2.yaml --plan 6", "--cell CELL.yaml or --at"),
    ("forces cuts.csv", "needs the tool"),
    (f"{SPRING} stiffness", "arm.compensator.stiffness_n_per_mm"),
    (f"{SPRING} colour", "one of stiffness, preload"),
    ("compliance --arm test_piece.yaml --plan 100 --postures 2", "only 8 are possible"),
    ("forces cuts.csv --teeth 0 --diameter-mm 20", "teeth"),
    ("forces cuts.csv --cell test_piece.yaml --tare 5:1", "tare"),
    ("material Al7075 --row 7 --out nowhere", "row"),
    ("material wood --out nowhere", "has no material"),
])  # fmt: skip
def test_what_is_missing_or_cannot_be_meant_is_refused_in_one_sentence(words, reason):
    assert reason in refused("identify", *words.split())


def test_too_few_load_tests_are_refused_with_the_name_of_the_file(tmp_path):
    head, first, *_ = (line for line in find_file("load_tests.csv").read_text().splitlines() if line[0] != "#")
    (tmp_path / "one.csv").write_text(f"{head}\n{first}\n")
    words = ("identify", "compliance", str(tmp_path / "one.csv"), "--arm", "kr270_2.yaml")
    assert "one.csv: 3 measured numbers for 3 unknown ones" in refused(*words)


# --- Errors in measurements are noticed: each row runs the public command and states the sentence and exit code ---
ANGLES = tuple(f"a{j}_deg" for j in range(1, 7))
SHIFTS, FORCES = ("dx_mm", "dy_mm", "dz_mm"), ("fx_n", "fy_n", "fz_n")
LOAD = ("compliance", "load_tests.csv", "--arm", "kr270_2.yaml", "--cell", "test_piece.yaml")
CUT = ("forces", "cuts.csv", "--cell", "test_piece.yaml")


def times(names, factor: float, row: int | None = None):
    def change(rows) -> None:
        for values in rows if row is None else [rows[row]]:
            values.update({name: repr(factor * float(values[name])) for name in names if values.get(name)})

    return change


def swapped(one: str, other: str):
    """Two columns, or two words of all columns."""
    names = {one: other, other: one}

    def change(rows) -> None:
        rows[:] = [{names.get(key, key): names.get(v, v) for key, v in values.items()} for values in rows]

    return change


def doubled(rows) -> None:
    rows.append(rows[3])


def in_turn(*changes):
    def change(rows) -> None:
        for each in changes:
            each(rows)

    return change


def hung_pounds(rows) -> None:
    """Hung masses alone, in pounds [0.45359237 kg] in the column of kg."""
    rows[:] = [row for row in rows if float(row["fx_n"]) == 0.0 == float(row["fy_n"])]
    for row in rows:
        row["mass_kg"] = repr(float(row["fz_n"]) / -9.80665 / 0.45359237)
        for name in compliance.WRENCH:
            del row[name]


TABLE = {
    "pounds for N": (LOAD, times(FORCES, 1 / 4.4482216), 2, "forces in pounds in the columns of N?"),
    "inch for mm": (LOAD, times(SHIFTS, 1 / 25.4), 2, "displacements in inch in the columns of mm?"),
    "pounds for kg": (LOAD, hung_pounds, 0, "masses in pounds in the column of kg?"),
    "displacements 20 times as large": (LOAD, times(SHIFTS, 20.0), 0, "times what the arm file predicts"),
    "a test entered twice": (LOAD, doubled, 0, "test 19 = 4 to the digit: entered twice?"),
    "a cut entered twice": (CUT, doubled, 0, "cut 13 = 4 to the digit: entered twice?"),
    "a plate under the part": (CUT, times(FORCES, -1.0), 1, "--sensor-on part"),
    "fx and fy swapped": (CUT, swapped(*FORCES[:2]), 1, "with x and y swapped they are those of a cut"),
    "sign of fx": (CUT, times(FORCES[:1], -1.0), 1, "with the sign of x changed they are"),
    "sign of fy": (CUT, times(FORCES[1:2], -1.0), 1, "with the sign of y changed, or the other"),
    "sensor turned": (
        CUT,
        in_turn(swapped(*FORCES[:2]), times(FORCES[:1], -1.0)),
        1,
        "the sensor turned (--sensor-abc -90,0,0)",
    ),
    "cuts in pounds": (CUT, times(FORCES, 1 / 4.4482216), 0, "forces in pounds in the columns of N"),
    "metres for mm": (LOAD, times(SHIFTS, 1e-3), 2, "displacements in m in the columns of mm"),
    "kgf for N": (LOAD, times(FORCES, 1 / 9.80665), 2, "forces in kgf in the columns of N?"),
    "kN for N": (LOAD, times(FORCES, 1e-3), 2, "forces in kN in the columns of N?"),
    "radians for degrees": (LOAD, times(ANGLES, np.pi / 180), 2, "radians in the columns of degrees?"),
    "x and y of the displacements swapped": (LOAD, swapped(*SHIFTS[:2]), 1, "x and y of the displacements swapped"),
    "x and y of the loads swapped": (LOAD, swapped(*FORCES[:2]), 1, "x and y of the loads swapped"),
    "wrong sign": (LOAD, times(SHIFTS, -1.0), 1, "the arm moved against its loads: look at the signs"),
    "one value ten times too large": (LOAD, times(["dx_mm"], 10.0, 9), 0, "test 10 contradicts the others"),
    "one large value ten times too large": (LOAD, times(["dz_mm"], 10.0, 4), 1, "test 5 contradicts the others"),
    "forces in kN": (CUT, times(FORCES, 1e-3), 0, "forces in kN in the columns of N?"),
    "feed per revolution": (CUT, times(["feed_per_tooth_mm"], 4.0), 0, "is feed_per_tooth_mm the feed per revolution?"),
    "up and down swapped": (CUT, swapped("up", "down"), 1, "up and down milling are swapped?"),
    "one force ten times too large": (CUT, times(["fy_n"], 10.0, 3), 1, "cut 4 contradicts the others"),
    "one force three times too large": (CUT, times(["fy_n"], 3.0, 9), 0, "cut 10 contradicts the others"),
    "no force": (CUT, times(FORCES, 0.0), 1, "negative or zero, which no cut has"),
}


def rows_of(name: str) -> list[dict]:
    with open(find_file(name), encoding="utf-8") as stream:
        return list(csv.DictReader(line for line in stream if not line.startswith("#")))


def written(folder, rows: list[dict], separator: str = ",") -> str:
    path = folder / "table.csv"
    with open(path, "w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, rows[0], delimiter=separator)
        writer.writeheader()
        writer.writerows(rows)
    return str(path)


def identified(kind: str, table: str, *words: str) -> tuple[int, str]:
    answer = ask("identify", kind, table, *words)
    return answer.code, answer.out + answer.err


@pytest.mark.parametrize("name", TABLE)
def test_an_error_is_named_and_no_file_comes_from_a_useless_result(name, tmp_path):
    """pytest turns every warning of Python into an error, so none reaches a terminal."""
    (kind, source, *words), change, code, sentence = TABLE[name]
    rows = rows_of(source)
    change(rows)
    ended, text = identified(kind, written(tmp_path, rows), *words, "--out", str(tmp_path / "out"))
    assert (ended, sentence in text) == (code, True), text
    assert (tmp_path / "out" / f"{kind}.yaml").exists() == (code == 0)


@pytest.mark.parametrize("name", [name for name in TABLE if "times too large" in name])
def test_a_robust_fit_gives_what_the_table_without_the_error_gives(name, tmp_path):
    (kind, source, *words), change, _, _ = TABLE[name]
    key = "compliance_urad_per_n_m" if kind == "compliance" else "tangential_cutting_n_per_mm2"
    rows, results = rows_of(source), []
    for more in ((), ("--robust",)):
        results.append(answered("identify", kind, written(tmp_path, rows), *words, *more)[key])
        change(rows)
    np.testing.assert_allclose(results[1], results[0], rtol=0.06)


@pytest.mark.parametrize("command", [LOAD, CUT])
def test_a_shipped_table_raises_no_doubt_and_a_german_spreadsheet_is_the_same_table(tmp_path, command):
    """Columns separated by semicolons, a comma for the point."""
    kind, source, *words = command
    german = [{k: v if k == "note" else v.replace(".", ",") for k, v in row.items()} for row in rows_of(source)]
    shipped = answered("identify", kind, source, *words)
    assert shipped["doubts"] == [] and shipped["usable"]
    assert answered("identify", kind, written(tmp_path, german, ";"), *words) == shipped


def campaign(folder, arm=TRUE, signs=1) -> str:
    rng, path = np.random.default_rng(3), str(folder / "campaign.csv")
    tests = measured(loads(rng, 24), arm, rng)
    compliance.write_measurements(path, dataclasses.replace(tests, q=tests.q * signs))
    return path


def test_angles_of_another_sign_and_a_base_that_tilts_are_named(tmp_path):
    """A1 counted about +z, as ROS does."""
    table = campaign(tmp_path, signs=[-1, 1, 1, 1, 1, 1])
    code, text = identified("compliance", table, "--arm", "test_piece.yaml")
    assert code == 1 and "with the sign of A1 changed" in text, text
    tilted = campaign(tmp_path, TRUE.replace(base_compliance=np.array([0.3e-6, 0.3e-6, 0.0])))
    _, text = identified("compliance", tilted, "--arm", "test_piece.yaml")
    assert "the residuals look like a base that tilts by 0.3, 0.3 urad/(N m) about x, y" in text, text
    code, text = identified("compliance", tilted, "--arm", "test_piece.yaml", "--base")
    assert code == 0 and "look like a base" not in text


# --- The page ---
PAGE = pages.ROOT / "kr270_milling/guide/identification.md"


@pytest.fixture(scope="module")
def ran(tmp_path_factory) -> dict:
    """Every command of the page in its order, in one directory: its result, and the lines that differ on the page."""
    place, outcome, results, show = tmp_path_factory.mktemp("page"), {}, [], Answer.print

    def recorded(answer: Answer, as_json: bool) -> int:
        results.append(answer.result)
        return show(answer, as_json)

    def run(line: str, expected: int) -> str:
        text = pages.run_here(line, expected)
        if not line.startswith("cat "):
            outcome[line] = results[-1]
        return text

    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        patch.setattr(Answer, "print", recorded)
        blocks = list(pages.run_page(PAGE, run, release=LONG))
    wrong = [line for block, printed in blocks for shown in block.shown for line in pages.differences(shown, printed)]
    return {"place": place, "wrong": wrong, **outcome}


def result(ran: dict, *words: str) -> dict:
    (outcome,) = [value for line, value in ran.items() if all(word in line for word in words)]
    return outcome


def test_the_identified_arm_coefficients_and_modes_are_those_that_the_examples_were_made_with(ran):
    arm = result(ran, "load_tests.csv")
    truth = np.array([0.26, 0.15, 0.26, 1.79, 1.52, 2.13]) * [1.18, 0.92, 1.10, 0.85, 1.12, 1.25]
    away = np.abs(np.array(arm["compliance_urad_per_n_m"]) - truth) / arm["ci95_urad_per_n_m"]
    assert all(arm["identifiable"]) and away.max() < 1.5 and arm["test_pose"]["share"] < 0.03
    forces = result(ran, "cuts.csv")
    for side, true in (("tangential", 767.01), ("radial", 168.8), ("axial", 222.0)):
        key = f"{side}_cutting_n_per_mm2"
        assert abs(forces[key] - true) < 1.5 * forces["ci95"][key]
    cell = ran["place"] / "rung.yaml"
    cell.write_text('/**:\n  ros__parameters:\n    includes: ["my_slot.yaml", "identified/modes.yaml"]\n')
    assert read_cell(cell).dynamics.modes.frequency == pytest.approx([11.0, 15.0, 23.0], rel=2e-3)


def test_the_page_shows_what_is_printed(ran):
    assert ran["wrong"] == []


@pytest.mark.skipif(not LONG, reason="two verdicts: two minutes; set KR270_MILLING_LONG_TESTS")
def test_the_identified_band_is_narrower(ran):
    bands = [result(ran, "compensate", out)["verdict"]["original_um"] for out in ("--out before", "--out after")]
    before, after = ((high - low) / (high + low) for low, _, high in bands)
    assert after < 0.7 * before


def test_the_plan_is_written_as_a_program_and_a_table_to_fill_in(ran):
    program = (ran["place"] / "plan" / "LOADTEST.src").read_text()
    assert program.count("PTP {A1 ") == 12 and program.count("HALT") == 24
    with (ran["place"] / "plan" / "plan.csv").open() as stream:
        rows = list(csv.reader(line for line in stream if not line.startswith("#")))
    assert len(rows) == 13 and set(rows[0]) <= set(compliance.COLUMNS)


# --- A measured wall beside the predicted wall ---
def wall_table(folder, header: str, rows) -> str:
    path = folder / "wall.csv"
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return str(path)


def test_the_walls_of_the_slot_are_off_by_the_static_deviation_of_table_2(tmp_path):
    """58.1 um [Klimchik2014], Table 2: the tool moves to the left, cuts the left wall away and leaves the right one."""
    rows = [f"{x},{y},0" for y in (10, -10) for x in (40, 50, 60)]
    table = wall_table(tmp_path, "x_mm,y_mm,error_um", rows)
    compared = compare_wall(read_cell(find_file("paper.yaml")), read_wall(table), plants=4)
    np.testing.assert_allclose(compared.predicted, 58.1e-6 * np.array([-1] * 3 + [1] * 3), atol=0.5e-6)
    assert np.all(compared.low < compared.predicted) and np.all(compared.predicted < compared.high)


@pytest.mark.parametrize(("header", "rows", "reason"), [
    ("x_mm,y_mm,error_um", ["40,10,-58", "40,20,-58", "50,10,-58"], r"line 3.*the place 40, 20 mm is farther than 2"),
    ("x_mm,y_mm,error_um", ["40,10,-58000"] * 3, "line 2.*error_um must be in um and at most 5000"),
    ("x_mm,y_mm,error_um", ["40,10,-58"], "has 1 place, but a comparison needs at least 3"),
])  # fmt: skip
def test_a_wall_that_cannot_be_compared_is_refused_with_its_line(header, rows, reason, tmp_path):
    quick = [*settings("stock.grid_step_um=40", "exchange.micro_step_deg=3"), "--plants", "4"]
    assert re.search(reason, refused("compare", wall_table(tmp_path, header, rows), "paper.yaml", *quick))
