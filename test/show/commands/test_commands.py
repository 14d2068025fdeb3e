"""The commands about cells and recordings, as a user calls them: init, keys, info, export, recover, replay, report."""

import json
import shutil
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import yaml
from hostile import answered, ask, contents, refused, settings
from samples import pass_recording as made

from kr270_milling.base.parameter_file import from_display
from kr270_milling.base.record import flat, flatten
from kr270_milling.base.samples import WrenchSample
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.keys import keys_of
from kr270_milling.cell.models import arm_model_of, path_of, thin_chips
from kr270_milling.recordings.bag.writer import BagWriter
from kr270_milling.recordings.messages.codec import to_bytes
from kr270_milling.show.commands.reports import unique_names

PROGRAMS = Path(__file__).parents[2] / "path" / "programs"
TEST_PIECE = Path(__file__).parents[3] / "config" / "test_piece.nc"
#: a shallow slot beside which the tool comes down
SLOT = "(T1 D=10 - flat end mill, 4 flutes)\nG21 G90 G54\nS6000 M3\nG0 X-20 Y0 Z5\nZ-0.5\nG1 X-2 F1200\nG0 Z5\nM30\n"


def cell_of(tmp_path, *words):
    answer = ask("init", *map(str, words))
    known = ("a rapid move goes below", "does not state the diameter")
    assert answer.code == 0 and all(any(words in line for words in known) for line in answer.err.splitlines())
    (tmp_path / "my.yaml").write_text(answer.out)
    return read_cell(tmp_path / "my.yaml")


@pytest.mark.parametrize(
    ("name", "robot"), [("fusion_haas.nc", "kr270_2"), ("sinumerik.mpf", "kr270_r2700_ultra"), ("haas.nc", "kr270_2")]
)
def test_a_cell_of_a_program_reaches_the_whole_pocket(tmp_path, name, robot):
    tool = ["--tool", "T1"] if name == "haas.nc" else []
    cell = cell_of(tmp_path, "--gcode", PROGRAMS / name, "--robot", robot, *tool)
    assert cell.tool.spindle_speed * 30 / np.pi == pytest.approx(5000)
    assert cell.tool.diameter == pytest.approx(0.010)
    blank = [[-30, -25, -10], [30, 25, 0]] if name == "sinumerik.mpf" else [[-24, -20, -6], [24, 20, 0]]  # WORKPIECE
    np.testing.assert_allclose([1e3 * cell.stock.min, 1e3 * cell.stock.max], blank, atol=1e-9)
    assert len(path_of(cell).target) > 1000  # on the joints of the arm
    np.testing.assert_allclose(1e3 * cell.workpiece.xyz, [1500, 0, 800])


def test_the_stock_leaves_room_where_the_tool_comes_down_rapidly(tmp_path):
    (tmp_path / "slot.nc").write_text(SLOT)
    cell = cell_of(tmp_path, "--gcode", tmp_path / "slot.nc")
    assert cell.stock.min[0] >= -20e-3 + cell.tool.radius and cell.stock.max[0] >= 0.0
    piece = cell_of(tmp_path, "--gcode", TEST_PIECE)
    path = path_of(piece).timed.toolpath
    down = path.position[path.rapid & (path.position[:, 2] < 0.0)][:, :2]
    beside = np.maximum(np.maximum(piece.stock.min[:2] - down, down - piece.stock.max[:2]), 0.0)
    assert np.hypot(*beside.T).min() > piece.tool.radius


def test_a_program_that_takes_an_hour_is_modelled_at_as_many_postures_as_a_cell_may_have(tmp_path):
    (tmp_path / "slow.nc").write_text(SLOT.replace("F1200", "F1"))  # 18 mm at 1 mm/min
    cell = cell_of(tmp_path, "--gcode", tmp_path / "slow.nc")
    assert path_of(cell).target.duration_ns > 1000e9
    assert len(arm_model_of(cell, path_of(cell).target).transition) < 50_000  # more than 100,000 are refused


def test_a_written_cell_moves_with_the_program_beside_it_and_an_error_leaves_no_file(tmp_path):
    (tmp_path / "part").mkdir()
    (tmp_path / "part" / "air.nc").write_text("G21 S6000 M3\nG0 X0 Y0 Z5\nX10 F600\nM30\n")
    (tmp_path / "part" / "slot.nc").write_text(SLOT)
    cell = tmp_path / "my.yaml"
    words = ("init", "--out", str(cell), "--gcode")
    assert "has no cutting move" in refused(*words, str(tmp_path / "part" / "air.nc")) and not cell.exists()
    assert "lines marked yours are guesses" in ask(*words, str(tmp_path / "part" / "slot.nc")).out
    moved = tmp_path.rename(tmp_path.with_name("moved")) / "my.yaml"
    drafted = yaml.safe_load(moved.read_text())["/**"]["ros__parameters"]
    assert drafted["path"]["file"] == "part/slot.nc" and drafted["program"]["name"] == "SLOT"
    assert "fixtures_mm" in drafted["workpiece"] and read_cell(moved).path.file.endswith("/moved/part/slot.nc")
    defaults = {row["key"].partition(".")[2]: row["default"] for row in keys_of("uncertainty")}
    assert drafted["uncertainty"].items() <= defaults.items()
    assert "exists already" in refused("init", "--out", str(moved))


def test_a_cell_without_a_program_is_a_straight_cut_and_one_of_several_tools_has_tools(tmp_path):
    cell = cell_of(tmp_path)
    assert cell.path.length == pytest.approx(0.040) and not cell.path.file
    cell = yaml.safe_load(answered("init", "--gcode", PROGRAMS / "haas.nc")["cell"])["/**"]["ros__parameters"]
    assert "tool" not in cell and [one["diameter_mm"] for one in cell["tools"].values()] == [10.0, 6.0]
    sentence = refused("init", "--gcode", str(PROGRAMS / "haas.nc"), "--tool", "T9")
    assert "does not cut with T9; it does with T1" in sentence
    answer = answered("init", "--gcode", PROGRAMS / "sinumerik.mpf")
    assert "# yours: the arm" in answer["cell"] and answer["program"]["work_offset"] == "G54"


HOLE = "(T3 D=6. - drill)\nG21 G90 G54\nT3 M6\nS3000 M3\nG0 X20 Y10 Z15\n{} X20 Y10 Z-12 R{} Q3 F200\nG80\nM30\n"


@pytest.mark.parametrize("cycle", ["G81", "G82", "G83", "G73"])
@pytest.mark.parametrize("retract", [3, -2])
def test_the_cell_of_a_drill_has_two_lips_and_a_stock_with_the_hole_inside(tmp_path, cycle, retract):
    (tmp_path / "hole.nc").write_text(HOLE.format(cycle, retract))
    cell = cell_of(tmp_path, "--gcode", tmp_path / "hole.nc")
    assert cell.tool.teeth == 2 and cell.tool.diameter == pytest.approx(6e-3)
    np.testing.assert_allclose(1e3 * cell.stock.min, [12, 2, -17], atol=1e-9)  # 3 mm of drill and 5 mm
    np.testing.assert_allclose(1e3 * cell.stock.max, [28, 18, 0], atol=1e-9)


def test_init_reports_guesses_that_hide_a_danger_and_refuses_a_tilted_tool(tmp_path):
    bull_nose, bare = "a bull-nose mill, is not stated in full", "does not state the diameter of T1: 10 mm"
    for name, old, new, warnings in (
        ("ball", "flat", "ball", ""),
        ("bull", "flat", "bull nose", bull_nose),
        ("bare", "D=10", "", bare),
        ("rapid", "\nZ-0.5\nG1", "\nG0 Z-0.5\nG1", "line 5: a rapid move goes below the top of the cut: the stock is"),
    ):
        fed = SLOT if name == "rapid" else SLOT.replace("Z-0.5\nG1", "G1 Z-0.5 F300\n")
        assert old in fed
        (tmp_path / "end.nc").write_text(fed.replace(old, new).replace("S6000", "T1 M6 S6000"))
        answer = ask("init", "--gcode", str(tmp_path / "end.nc"), "--out", str(tmp_path / f"{name}.yaml"))
        assert answer.code == 0 and warnings in answer.err and bool(warnings) == bool(answer.err), answer.err
    assert read_cell(tmp_path / "ball.yaml").tool.type == "ball"
    (tmp_path / "two.nc").write_text((PROGRAMS / "haas.nc").read_text().replace("G54 X20", "G55 X20"))
    assert "cut in G54 and G55: check needs their places" in ask("init", "--gcode", str(tmp_path / "two.nc")).err
    tilted = "UNITS/MM\nMULTAX/ON\nFEDRAT/500,MMPM\nGOTO/0,0,5,0,0,1\nGOTO/9,0,0,0.9798,0,0.2\nFINI\n"
    (tmp_path / "tilted.apt").write_text(tilted)
    (tmp_path / "axes.nc").write_text(SLOT.replace("X-2 F", "X-2 A30 F"))
    for name, message in (("tilted.apt", "tilted by 78.46 deg"), ("axes.nc", "A30: state the machine")):
        assert message in refused("init", "--gcode", str(tmp_path / name), "--out", str(tmp_path / "no.yaml"))
    assert not (tmp_path / "no.yaml").exists()


# --- keys ---
def test_every_parameter_has_a_key_with_a_meaning_that_ends_in_its_unit():
    rows = {row["key"]: row for row in keys_of()}
    shipped = set(flatten(read_cell(TEST_PIECE.with_suffix(".yaml"))))
    more = set(rows) - shipped - {"workpiece.table_z_mm", "exchange.engagement_period_ms"}  # by stock and tool
    assert shipped < set(rows) and all(key.startswith("cutting.fractional") for key in more)
    assert len(rows) == len(keys_of())
    for key, row in rows.items():
        assert row["text"] and key.endswith(row["unit"]), key
        assert row["text"].split()[0] not in ("of", "its"), key  # the meaning begins with its noun


def test_keys_lists_those_that_init_writes_and_with_all_or_by_its_name_a_key_for_experts():
    drafts = [read_tree_of(answered("init", *words)["cell"]) for words in ((), ("--gcode", TEST_PIECE))]
    written = {key for draft in drafts for key in flat(draft)} | {"tool.spindle_speed_rpm", "path.tool"}
    listed, all_keys, chosen = (ask("keys", *words).out for words in ((), ("--all",), ("tool.helix_deg",)))
    assert {line.split()[0] for line in listed.splitlines()[1:-1]} == written
    assert {line.split()[0] for line in all_keys.splitlines()[1:]} == {row["key"] for row in keys_of()}
    assert f"not shown: {len(keys_of()) - len(written)} keys for experts" in listed and "tool.helix_deg" in chosen
    assert "not shown: 1 key for experts" in ask("keys", "mount").out
    assert {row["key"] for row in answered("keys")["keys"] if not row["expert"]} == written


def read_tree_of(text: str) -> dict:
    tree = yaml.safe_load(text)["/**"]["ros__parameters"]
    del tree["includes"]
    return from_display(tree, "")


def test_the_schema_of_a_cell_file_accepts_the_shipped_files_and_refuses_what_the_reader_refuses():
    validator = jsonschema.Draft202012Validator(json.loads(ask("keys", "--schema").out))
    files = [
        path.read_text() for path in (*TEST_PIECE.parent.glob("*.yaml"), *Path(__file__).parents[2].rglob("*.yaml"))
    ]
    for text in (*files, answered("init")["cell"], answered("init", "--gcode", PROGRAMS / "haas.nc")["cell"]):
        assert [error.message for error in validator.iter_errors(yaml.safe_load(text))] == []
    wrong = ("tool: {diametre_mm: 1.0}", "tool: {teeth: 0}", "tool: {rotation: left}", "stock: {min_mm: [0.0, 0.0]}",
             "mount: {tool_kuka: {Q: 1.0}}", "tools: {T1: {path: {}}}", "exchange: {period_ms: 0.0}")  # fmt: skip
    for text in wrong:
        assert not validator.is_valid({"/**": {"ros__parameters": yaml.safe_load(text)}}), text


SLOW = "(T1 D={0} - flat end mill, {1} flutes)\nG21 G90 G54\nS{2} M3\nG0 X-20 Y0 Z5\nZ-0.5\nG1 X20 F{3}\nG0 Z5\nM30\n"


@pytest.mark.parametrize(("diameter", "teeth", "speed", "feed"), [
    (20, 4, 8000, 4000), (10, 4, 8000, 640), (6, 2, 15000, 600), (4, 3, 18000, 540),
    (12, 4, 6000, 1200), (3, 2, 20000, 400),
])  # fmt: skip
def test_grid_and_period_follow_tool_and_feed_where_the_cell_does_not_state_them(
    tmp_path, diameter, teeth, speed, feed
):
    """The teeth resolve the chips: f R dphi / ds^2 >= 10; and the period is 0.25 ms in whole micro-steps."""
    (tmp_path / "slot.nc").write_text(SLOW.format(diameter, teeth, speed, feed))
    cell = cell_of(tmp_path, "--gcode", tmp_path / "slot.nc")
    per_tooth = 1e-3 * feed / (speed * teeth)
    step = cell.stock.grid_step
    assert per_tooth * 0.5e-3 * diameter * np.radians(1.0) / step**2 >= 10.0 and not thin_chips(cell)
    assert 4.9e-6 <= step <= max(0.4 * per_tooth, 5e-6) and step <= 0.05 * 0.5e-3 * diameter
    steps = cell.exchange.period * speed * 6.0
    assert steps == pytest.approx(round(steps)) and abs(cell.exchange.period - 0.25e-3) < 1.0 / (6.0 * speed)
    stated = read_cell(tmp_path / "my.yaml", ["stock.grid_step_um=50", f"exchange.period_ms={60 / speed * 1e3}"])
    assert stated.stock.grid_step == pytest.approx(50e-6) and stated.exchange.period == pytest.approx(60 / speed)
    assert "stock:" in answered("init")["cell"] and "grid_step" not in (tmp_path / "my.yaml").read_text()


def test_the_usual_period_follows_an_arm_that_bounces_on_its_end_edges(tmp_path):
    """The thrust of a ramp with a share of 1 is that of half the period; with 0.25 ms it is 8 % larger."""
    head, moves = (
        "(T1 D=10. - flat end mill)\nG21 G90 G54\nS8000 M3\nG0 X-10 Y-10 Z2\n",
        "G1 Z0 F1000\nX10 Z-1 F2000\nG0 Z2\nM30\n",
    )
    (tmp_path / "ramp.nc").write_text(head + moves)
    cell_of(tmp_path, "--gcode", tmp_path / "ramp.nc")
    thrust = []
    for words in ([], ["exchange.period_ms=0.0625"], ["exchange.period_ms=0.25"]):
        ran = simulate(read_cell(tmp_path / "my.yaml", ["cutting.end_share=1", *words])).result
        sinking = (np.gradient(ran.target[:, 2]) < 0.0) & (ran.target[:, 2] < -0.7e-3)
        thrust.append(ran.wrench[sinking, 2].mean())
    assert thrust[0] == pytest.approx(thrust[1], rel=0.02) and thrust[2] > 1.05 * thrust[1]


def test_check_prints_tolerance_stability_and_the_answer_and_with_v_everything(tmp_path):
    words = ("check", "paper.yaml", *settings("path.length_mm=4", "stock.grid_step_um=40", "stock.max_mm=[4,12,0]"))
    short, long = (ask(*words, *more).out.splitlines() for more in ((), ("-v",)))
    assert [line.partition(":")[0] for line in short] == ["as programmed", "stability", "3 points, 0 stops, 0 warnings"]
    assert set(short) < set(long) and any(line.startswith("$TOOL=") for line in long)
    stopped = ask(*words, *settings("limits.spindle_power_kw=0.001"))
    assert stopped.code == 1 and any(line.startswith("stop     the spindle power") for line in stopped.out.splitlines())


def test_keys_of_a_section_have_bounds_and_defaults_in_their_unit():
    rows = {row["key"]: row for row in answered("keys", "timing")["keys"]}
    expected = {"unit": "ms", "low": 1, "high": 1000, "default": 50, "required": False}
    assert expected.items() <= rows["timing.controller_step_ms"].items()
    assert "K_tc" in ask("keys", "cutting.linear_edge").out and "known are arm" in refused("keys", "tols")


# --- recordings ---
@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    pytest.importorskip("geometry_msgs")
    return str(made.write(tmp_path_factory.mktemp("files") / "r", made.one_pass()))


def test_a_cut_off_recording_is_counted_exported_and_recovered(whole, tmp_path):
    data, file, saved = Path(whole, "r.mcap").read_bytes(), tmp_path / "cut.mcap", tmp_path / "saved"
    file.write_bytes(data[: len(data) * 2 // 3])
    result = answered("info", whole)
    assert result["cut_off"] is False and result["messages"] == len(made.one_pass())
    assert answered("info", file)["cut_off"] is True and "cut off" in ask("info", str(file)).out
    words = ("export", str(file), "--csv", str(tmp_path / "t"), "--topics", "/wrench")
    assert answered(*words)["files"] == [str(tmp_path / "t" / "wrench.csv")] and "was cut off" in ask(*words).out
    result = answered("recover", file, "--out", saved)
    assert not result["whole"] and result["messages"] > 100 and answered("info", saved)["cut_off"] is False
    assert answered("replay", saved, "--recompute")["verdict"] == "identical"


def test_recompute_ends_with_0_when_identical_and_1_when_not_or_when_it_cannot_continue(whole, tmp_path):
    def recomputed(index, change) -> str:
        return str(made.write(tmp_path / str(index), made.changed(made.one_pass(), "wrench", index, change)))

    answer = ask("replay", whole, "--recompute")
    assert answer.code == 0 and "identical: " in answer.out
    other = recomputed(60, lambda data: data[:40] + bytes([data[40] ^ 1]) + data[41:])
    difference = "first difference: /wrench, message 60 at 0.030000 s: wrench.force.y"
    assert difference in ask("replay", other, "--recompute").out
    result = answered("replay", other, "--recompute", code=1)["first_difference"]
    assert (result["topic"], result["index"], result["stamp_ns"]) == ("/wrench", 60, 30_000_000)
    answer = ask("replay", recomputed(40, lambda data: None), "--recompute")
    assert answer.code == 1 and "cannot continue at 0.020000 s" in answer.out


# --- The command report: which recordings it takes and where it writes ---
def test_the_report_of_a_directory_goes_into_it_whether_it_holds_files_or_directories(whole, tmp_path):
    for place in ("files/a.mcap", "files/b.mcap", "directories/a/a.mcap", "one/r.mcap"):
        (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(Path(whole, "r.mcap"), tmp_path / place)
    for place in ("files", "directories", "one/r.mcap"):
        assert ask("report", str(tmp_path / place)).code == 0
    pages = [name for name in contents(tmp_path) if name.endswith("report.html")]
    assert pages == [f"{place}/report/report.html" for place in ("directories", "files", "one")]
    old = tmp_path / "directories" / "report.html"
    old.write_text("of the run")
    assert ask("report", str(tmp_path / "directories")).code == 0 and "of the run" not in old.read_text()[:100]
    for place, names in (("files", ("a.mcap", "b.mcap")), ("directories", ("a",))):
        listed = ", ".join(str(tmp_path / place / name) for name in names)
        assert refused("replay", str(tmp_path / place), "--recompute").endswith(f"name one of those in it: {listed}")


@made.needs_messages
def test_of_two_robots_in_a_recording_one_is_named(tmp_path):
    recording = str(made.write(tmp_path / "r", made.one_pass(), namespaces=("/left", "/right")))
    assert "name a namespace" in refused("report", recording)
    answer = ask("report", recording, "--namespace", "left")
    assert answer.code == 0 and (tmp_path / "r" / "report" / "report.html").is_file()


def test_copies_are_skipped_with_a_sentence_and_the_page_has_the_command(whole, tmp_path):
    for name in ("one", "one_recovered"):
        shutil.copytree(whole, tmp_path / "r" / name)
    answer = ask("report", str(tmp_path / "r"), str(tmp_path / "r" / "one" / "r.mcap"))
    assert answer.code == 0 and "skipped, a copy of another pass" in answer.out
    page = (tmp_path / "r" / "report" / "report.html").read_text()
    assert "kr270_milling report r r.mcap" in page and str(tmp_path) not in page


def test_passes_of_two_paths_are_not_compared(whole, tmp_path):
    target = path_of(made.cell_of()).target
    shifted = target.with_position(target.position + [0.0, 5e-4, 0.0])
    other = made.write(tmp_path / "b", made.target_of_user(shifted))
    assert "is a pass of another path than" in refused("report", whole, str(other))


def test_names_that_are_alike_get_their_directories():
    paths = [Path("run_1/original.mcap"), Path("run_2/original.mcap"), Path("run_2/spline.mcap")]
    assert unique_names(paths) == ["run_1/original", "run_2/original", "spline"]


# --- a graph whose topics were remapped ---
@pytest.fixture(scope="module")
def remapped(tmp_path_factory):
    """A pass of a robot in /left whose wrench was on force/measured; other sensors were on wrench and elsewhere."""
    pytest.importorskip("geometry_msgs")
    names, directory = {"wrench": "force/measured"}, tmp_path_factory.mktemp("remapped") / "r"
    with BagWriter(directory, attachments={"cell.yaml": made.cell_text()}) as writer:
        for name, kind in made.TYPES.items():
            profiles = [made.LATCHED] if name in made.LATCHED_TOPICS else ()
            writer.add_topic(f"/left/{names.get(name, name)}", kind, profiles)
        for name in ("/left/wrench", "/old/force/measured"):
            writer.add_topic(name, made.WRENCH)
        for k, message in enumerate(made.one_pass()):
            writer.write(f"/left/{names.get(message.topic, message.topic)}", message.data, 10**9 + k)
        for name in ("/left/wrench", "/old/force/measured"):
            writer.write(name, to_bytes(WrenchSample(0, "workpiece", np.ones(6))), 10**9)
    return str(directory)


@pytest.mark.parametrize("rule", ["wrench:=force/measured", "/left/wrench:=/left/force/measured"])
def test_a_recording_of_remapped_topics_is_used_with_their_names(remapped, tmp_path, rule):
    """The rule names a topic exactly: /old/force/measured is another one."""
    rule = ("--remap", rule)
    result = answered("replay", remapped, "--recompute", *rule)
    assert result["verdict"] == "identical" and result["channels"]["/left/wrench"]["compared"] == made.STEPS
    (ran,) = answered("report", remapped, "--out", tmp_path, *rule)["passes"]
    assert ran["complete"] and not ran["messages_lost"]
    (tmp_path / "cell.yaml").write_text(made.cell_text())
    assert "force x" in ask("compare", remapped, str(tmp_path / "cell.yaml"), *rule).out


def test_compare_takes_the_wrench_next_to_the_reference_of_several(tmp_path):
    (tmp_path / "cell.yaml").write_text(made.cell_text())
    with BagWriter(tmp_path / "r", attachments={"cell.yaml": made.cell_text()}) as writer:
        for name, kind in made.TYPES.items():
            writer.add_topic(f"/{name}", kind, [made.LATCHED] if name in made.LATCHED_TOPICS else ())
        writer.add_topic("/ft/wrench", made.WRENCH)
        for k, message in enumerate(made.one_pass()):
            writer.write(f"/{message.topic}", message.data, 10**9 + k)
            writer.write("/ft/wrench", to_bytes(WrenchSample(10**6 * k, "workpiece", np.ones(6))), 10**9 + k)
    assert "force x" in ask("compare", str(tmp_path / "r"), str(tmp_path / "cell.yaml")).out


@pytest.mark.parametrize(("rule", "sentence"), [
    ("wrnch:=force", "'wrnch' is not one of target_trajectory, robot_description, tool_pose, wrench, "),
    ("wrench=force", "'wrench=force' is not NAME:=RECORDED"),
    ("wrench:=force/other", "has no topic force/other"),
])  # fmt: skip
def test_a_wrong_remapping_is_one_sentence(remapped, rule, sentence):
    assert sentence in refused("replay", remapped, "--recompute", "--remap", rule)
    assert "a playback takes --ros-args -r RECORDED:=NAME" in refused("replay", remapped, "--remap", rule)
