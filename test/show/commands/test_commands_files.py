"""The commands about recordings, as a user calls them: info, export, recover, replay, report."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import numpy as np
import pass_recording as made
import pytest
from hostile import answered, ask, contents, refused

from kr270_milling.base.samples import WrenchSample
from kr270_milling.path.trajectory_csv import read_csv
from kr270_milling.recordings.bag.writer import BagWriter
from kr270_milling.recordings.messages.codec import to_bytes, wrench_from_bytes
from kr270_milling.show.commands.recordings import unique_names

pytestmark = made.needs_messages


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return str(made.write(tmp_path_factory.mktemp("files") / "r", made.one_pass()))


@pytest.fixture
def cut_off(whole, tmp_path):
    data = Path(whole, "r.mcap").read_bytes()
    file = tmp_path / "cut.mcap"
    file.write_bytes(data[: len(data) * 2 // 3])
    return str(file)


def test_info_counts_what_was_written_and_reports_a_cut_off_file(whole, cut_off):
    result = answered("info", whole)
    assert result["cut_off"] is False and result["messages"] == len(made.one_pass())
    assert result["topics"]["/wrench"]["count"] == 121 and result["duration_s"] == pytest.approx(0.0605)
    assert "/wrench" in ask("info", whole).out
    assert answered("info", cut_off)["cut_off"] is True and "cut off" in ask("info", cut_off).out


def test_export_writes_tables_that_read_back_to_the_bit_also_of_a_cut_off_file(whole, cut_off, tmp_path):
    table = tmp_path / "t" / "wrench.csv"
    words = ("--csv", str(tmp_path / "t"), "--topics")
    assert answered("export", whole, *words, "/wrench")["files"] == [str(table)]
    with open(table, newline="") as stream:
        rows = list(csv.DictReader(stream))
    sent = [wrench_from_bytes(m.data) for m in made.one_pass() if m.topic == "wrench"]
    assert [(int(r["stamp_ns"]), float(r["force_y_n"])) for r in rows] == [(s.stamp, s.wrench[1]) for s in sent]
    answer = ask("export", cut_off, *words, "/wrench")
    assert answer.code == 0 and "was cut off" in answer.out and table.stat().st_size > 1000
    refused("export", whole)  # without a format
    assert "/nothing" in refused("export", whole, *words, "/nothing")


def test_recover_makes_a_whole_file_that_is_recomputed(cut_off, tmp_path):
    saved = str(tmp_path / "saved")
    result = answered("recover", cut_off, "--out", saved)
    assert not result["whole"] and result["messages"] > 100
    assert answered("info", saved)["cut_off"] is False
    assert answered("replay", saved, "--recompute")["verdict"] == "identical"
    refused("recover", cut_off, "--out", saved)


def test_recompute_ends_with_0_when_identical_and_1_when_not_or_when_it_cannot_continue(whole, tmp_path):
    def recomputed(index, change) -> str:
        return str(made.write(tmp_path / str(index), made.changed(made.one_pass(), "wrench", index, change)))

    answer = ask("replay", whole, "--recompute")
    assert answer.code == 0 and "identical: " in answer.out
    other = recomputed(60, lambda data: data[:40] + bytes([data[40] ^ 1]) + data[41:])
    answer = ask("replay", other, "--recompute")
    assert answer.code == 1
    assert "first difference: /wrench, message 60 at 0.030000 s: wrench.force.y" in answer.out
    result = answered("replay", other, "--recompute", code=1)["first_difference"]
    assert (result["topic"], result["index"], result["stamp_ns"]) == ("/wrench", 60, 30_000_000)
    answer = ask("replay", recomputed(40, lambda data: None), "--recompute")
    assert answer.code == 1 and "cannot continue at 0.020000 s" in answer.out


def test_compensate_writes_the_trajectory_that_was_published(whole, tmp_path):
    words = ("replay", whole, "--compensate", "--out", str(tmp_path / "t"))
    result = answered(*words)["robots"][0]
    reference, joints = read_csv(result["csv"])
    published = [m.data for m in made.one_pass() if m.topic == "reference_trajectory"][1]
    assert result["identical_to_published"] is True and joints.shape == (len(reference), 6)
    assert to_bytes(reference)[12:] == published[12:]
    assert "identical to what the node published" in ask(*words).out


# --- The command report: which recordings it takes and where it writes ---


def test_the_report_of_a_directory_goes_into_it_whether_it_holds_files_or_directories(whole, tmp_path):
    for place in ("files/a.mcap", "files/b.mcap", "directories/a/a.mcap", "one/r.mcap"):
        (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(Path(whole, "r.mcap"), tmp_path / place)
    for place in ("files", "directories", "one/r.mcap"):
        assert ask("report", str(tmp_path / place)).code == 0
    pages = [name for name in contents(tmp_path) if name.endswith("report.html")]
    assert pages == [f"{place}/report/report.html" for place in ("directories", "files", "one")]
    of_the_run = tmp_path / "directories" / "report.html"
    of_the_run.write_text("of the run")
    assert ask("report", str(tmp_path / "directories")).code == 0
    assert "of the run" not in of_the_run.read_text()[:100]
    for place, names in (("files", ("a.mcap", "b.mcap")), ("directories", ("a",))):
        listed = ", ".join(str(tmp_path / place / name) for name in names)
        assert refused("replay", str(tmp_path / place), "--recompute").endswith(f"name one of those in it: {listed}")


def test_of_two_robots_in_a_recording_one_is_named(tmp_path):
    recording = str(made.write(tmp_path / "r", made.one_pass(), namespaces=("/left", "/right")))
    assert "name a namespace" in refused("report", recording)
    assert "is not recorded in the namespace middle" in refused("report", recording, "--namespace", "middle")
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
    target = made.cell_of().target()
    shifted = target.with_position(target.position + [0.0, 5e-4, 0.0])
    other = made.write(tmp_path / "b", made.target_of_user(shifted))
    assert "is a pass of another path than" in refused("report", whole, str(other))


def test_names_that_are_alike_get_their_directories():
    paths = [Path("run_1/original.mcap"), Path("run_2/original.mcap"), Path("run_2/spline.mcap")]
    assert unique_names(paths) == ["run_1/original", "run_2/original", "spline"]


# --- a graph whose topics were remapped ---


@pytest.fixture(scope="module")
def remapped(tmp_path_factory):
    """A pass of a robot in /left whose wrench was on force/measured; another sensor was on wrench."""
    names, directory = {"wrench": "force/measured"}, tmp_path_factory.mktemp("remapped") / "r"
    with BagWriter(directory, attachments={"cell.yaml": made.cell_text()}) as writer:
        for name, kind in made.TYPES.items():
            profiles = [made.LATCHED] if name in made.LATCHED_TOPICS else [{}]
            writer.add_topic(f"/left/{names.get(name, name)}", kind, profiles)
        writer.add_topic("/left/wrench", made.WRENCH)
        for k, message in enumerate(made.one_pass()):
            writer.write(f"/left/{names.get(message.topic, message.topic)}", message.data, 10**9 + k)
        writer.write("/left/wrench", to_bytes(WrenchSample(0, "workpiece", np.ones(6))), 10**9)
    return str(directory)


def test_a_recording_of_remapped_topics_is_used_with_their_names(remapped, tmp_path):
    rule = ("--remap", "wrench:=force/measured")
    result = answered("replay", remapped, "--recompute", *rule)
    assert result["verdict"] == "identical" and result["channels"]["/left/wrench"]["compared"] == made.STEPS
    assert answered("replay", remapped, "--compensate", "--out", tmp_path, *rule)["robots"]
    (ran,) = answered("report", remapped, "--out", tmp_path, *rule)["passes"]
    assert ran["complete"] and not ran["messages_lost"]
    (tmp_path / "cell.yaml").write_text(made.cell_text())
    assert "force x" in ask("compare", remapped, str(tmp_path / "cell.yaml"), *rule).out


@pytest.mark.parametrize(
    ("rule", "sentence"),
    [
        ("wrnch:=force", "'wrnch' is not one of target_trajectory, robot_description, tool_pose, wrench, "),
        ("wrench=force", "'wrench=force' is not NAME:=RECORDED"),
        ("wrench:=force/other", "has no topic force/other"),
    ],
)
def test_a_wrong_remapping_is_one_sentence(remapped, rule, sentence):
    assert sentence in refused("replay", remapped, "--recompute", "--remap", rule)
