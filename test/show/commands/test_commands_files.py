"""The commands about recordings, as a user calls them: info, export, recover, replay."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pass_recording as made
import pytest
from hostile import ask, refused

from kr270_milling import cli
from kr270_milling.base.samples import WrenchSample
from kr270_milling.cli import main
from kr270_milling.recordings.bag.writer import BagWriter
from kr270_milling.recordings.messages.codec import to_bytes
from kr270_milling.show.commands.recordings import unique_names

pytestmark = made.needs_messages


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return made.write(tmp_path_factory.mktemp("files") / "r", made.one_pass())


@pytest.fixture
def cut_off(whole, tmp_path):
    data = (whole / "r.mcap").read_bytes()
    file = tmp_path / "cut.mcap"
    file.write_bytes(data[: len(data) * 2 // 3])
    return file


def run(capsys, *words) -> tuple[int, str, str]:
    code = cli.main([str(word) for word in words])
    out, err = capsys.readouterr()
    assert "Traceback" not in out + err
    return code, out, err


def as_json(capsys, *words) -> dict:
    code, out, _ = run(capsys, *words, "--json")
    return json.loads(out) | {"code": code}


def test_info_counts_what_was_written(whole, capsys):
    result = as_json(capsys, "info", whole)
    assert result["code"] == 0 and result["cut_off"] is False and result["messages"] == len(made.one_pass())
    assert result["topics"]["/wrench"]["count"] == 121 and result["duration_s"] == pytest.approx(0.0605)
    assert "/wrench" in run(capsys, "info", whole)[1]


def test_info_of_a_cut_off_file_reports_it(cut_off, capsys):
    assert as_json(capsys, "info", cut_off)["cut_off"] is True
    assert "cut off" in run(capsys, "info", cut_off)[1]


def test_export_writes_tables_that_read_back_to_the_bit(whole, tmp_path, capsys):
    result = as_json(capsys, "export", whole, "--csv", tmp_path / "t", "--topics", "/wrench")
    assert result["files"] == [str(tmp_path / "t" / "wrench.csv")]
    with open(result["files"][0], newline="") as stream:
        rows = list(csv.DictReader(stream))
    from kr270_milling.recordings.messages.codec import wrench_from_bytes

    sent = [wrench_from_bytes(m.data) for m in made.one_pass() if m.topic == "wrench"]
    assert [(int(r["stamp_ns"]), float(r["force_y_n"])) for r in rows] == [(s.stamp, s.wrench[1]) for s in sent]


def test_export_of_a_cut_off_file_reports_it_and_writes_the_rest(cut_off, tmp_path, capsys):
    code, out, _ = run(capsys, "export", cut_off, "--csv", tmp_path / "t")
    assert code == 0 and "was cut off" in out and (tmp_path / "t" / "wrench.csv").stat().st_size > 1000


def test_export_without_a_format_or_with_an_unknown_topic_is_refused(whole, tmp_path, capsys):
    assert run(capsys, "export", whole)[0] == 2
    code, _, err = run(capsys, "export", whole, "--csv", tmp_path / "t", "--topics", "/nothing")
    assert code == 2 and "/nothing" in err


def test_recover_makes_a_whole_file_that_is_recomputed(cut_off, tmp_path, capsys):
    result = as_json(capsys, "recover", cut_off, "--out", tmp_path / "saved")
    assert result["code"] == 0 and not result["whole"] and result["messages"] > 100
    assert as_json(capsys, "info", tmp_path / "saved")["cut_off"] is False
    again = as_json(capsys, "replay", tmp_path / "saved", "--recompute")
    assert again["verdict"] == "identical" and again["code"] == 0
    assert run(capsys, "recover", cut_off, "--out", tmp_path / "saved")[0] == 2


def test_recompute_ends_with_0_when_identical_and_1_when_not(whole, tmp_path, capsys):
    code, out, _ = run(capsys, "replay", whole, "--recompute")
    assert code == 0 and "identical: " in out
    changed = made.changed(made.one_pass(), "wrench", 60, lambda data: data[:40] + bytes([data[40] ^ 1]) + data[41:])
    other = made.write(tmp_path / "other", changed)
    code, out, _ = run(capsys, "replay", other, "--recompute")
    assert code == 1 and "first difference: /wrench, message 60 at 0.030000 s: wrench.force.y" in out
    result = as_json(capsys, "replay", other, "--recompute")["first_difference"]
    assert (result["topic"], result["index"], result["stamp_ns"]) == ("/wrench", 60, 30_000_000)


def test_recompute_that_cannot_continue_ends_with_1_and_the_place(tmp_path, capsys):
    gap = made.write(tmp_path / "r", made.changed(made.one_pass(), "wrench", 40, lambda data: None))
    code, out, _ = run(capsys, "replay", gap, "--recompute")
    assert code == 1 and "cannot continue at 0.020000 s" in out


def test_compensate_writes_the_trajectory_that_was_published(whole, tmp_path, capsys):
    from kr270_milling.path.trajectory_csv import read_csv

    result = as_json(capsys, "replay", whole, "--compensate", "--out", tmp_path / "t")
    assert result["code"] == 0 and result["robots"][0]["identical_to_published"] is True
    run_csv, joints = read_csv(result["robots"][0]["csv"])
    published = [m.data for m in made.one_pass() if m.topic == "reference_trajectory"][1]
    assert made.reference_data(run_csv)[12:] == published[12:] and joints.shape == (len(run_csv), 6)
    assert "identical to what the node published" in run(capsys, "replay", whole, "--compensate")[1]


# --- The command report: which recordings it takes and where it writes ---


def test_the_report_of_a_directory_goes_into_it_whether_it_holds_files_or_directories(tmp_path):
    recording = made.write(tmp_path / "made" / "one", made.one_pass()) / "one.mcap"
    for place in ("files/a.mcap", "files/b.mcap", "directories/a/a.mcap"):
        (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(recording, tmp_path / place)
    for place in ("files", "directories", "made/one/one.mcap"):
        assert ask("report", str(tmp_path / place)).code == 0
    pages = [str(page.relative_to(tmp_path)) for page in tmp_path.rglob("report.html")]
    assert sorted(pages) == [f"{place}/report/report.html" for place in ("directories", "files", "made/one")]
    (tmp_path / "directories" / "report.html").write_text("of the run")
    assert ask("report", str(tmp_path / "directories")).code == 0
    assert "of the run" not in (tmp_path / "directories" / "report.html").read_text()[:100]
    for place, names in (("files", ("a.mcap", "b.mcap")), ("directories", ("a",))):
        listed = ", ".join(str(tmp_path / place / name) for name in names)
        assert refused("replay", str(tmp_path / place), "--recompute").endswith(f"name one of those in it: {listed}")


def test_of_two_robots_in_a_recording_one_is_named(tmp_path):
    recording = str(made.write(tmp_path / "r", made.one_pass(), namespaces=("/left", "/right")))
    assert "name a namespace" in refused("report", recording)
    assert "is not recorded in the namespace middle" in refused("report", recording, "--namespace", "middle")
    answer = ask("report", recording, "--namespace", "left")
    assert answer.code == 0 and (tmp_path / "r" / "report" / "report.html").is_file()


def test_copies_are_skipped_with_a_sentence_and_the_page_has_the_command(tmp_path):
    recording = made.write(tmp_path / "r" / "one", made.one_pass()) / "one.mcap"
    shutil.copytree(tmp_path / "r" / "one", tmp_path / "r" / "one_recovered")
    answer = ask("report", str(tmp_path / "r"), str(recording))
    assert answer.code == 0 and "skipped, a copy of another pass" in answer.out
    page = (tmp_path / "r" / "report" / "report.html").read_text()
    assert "kr270_milling report r one.mcap" in page and str(tmp_path) not in page


def test_passes_of_two_paths_are_not_compared(tmp_path):
    target = made.cell_of().target()
    shifted = target.with_position(target.position + [0.0, 5e-4, 0.0])
    first = made.write(tmp_path / "a", made.one_pass())
    second = made.write(tmp_path / "b", made.target_of_user(shifted))
    assert "is a pass of another path than" in refused("report", str(first), str(second))


def test_names_that_are_alike_get_their_directories(tmp_path):
    paths = [Path("run_1/original.mcap"), Path("run_2/original.mcap"), Path("run_2/spline.mcap")]
    assert unique_names(paths) == ["run_1/original", "run_2/original", "spline"]


def test_a_whole_recording_is_left_alone_by_recover(tmp_path):
    directory = made.write(tmp_path / "one", made.one_pass())
    answer = ask("recover", str(directory))
    assert answer.code == 0 and "nothing to recover; unchanged" in answer.out
    assert sorted(p.name for p in tmp_path.iterdir()) == ["one"]


def test_a_second_plain_demo_prints_first_that_it_replaces_the_report(tmp_path, monkeypatch, capsys):
    def stop(*_):
        raise KeyboardInterrupt

    (tmp_path / "report.html").write_text("old")
    monkeypatch.setattr("kr270_milling.show.commands.demo._plain", stop)
    assert main(["demo", "--plain", "--out", str(tmp_path)]) == 130
    assert "holds a report already; it is replaced" in capsys.readouterr().err
    assert (tmp_path / "report.html").read_text() == "old"


# --- a graph whose topics were remapped ---


@pytest.fixture(scope="module")
def remapped(tmp_path_factory):
    """A pass of a robot in /left whose wrench was on force/measured; another sensor was on wrench."""
    names, directory = {"wrench": "force/measured"}, tmp_path_factory.mktemp("remapped") / "r"
    with BagWriter(directory, attachments={"cell.yaml": made.cell_text()}) as writer:
        for name, kind in made.TYPES.items():
            writer.add_topic(
                f"/left/{names.get(name, name)}", kind, [made.LATCHED] if name in made.LATCHED_TOPICS else [{}]
            )
        writer.add_topic("/left/wrench", made.WRENCH)
        for k, message in enumerate(made.one_pass()):
            writer.write(f"/left/{names.get(message.topic, message.topic)}", message.data, 10**9 + k)
        writer.write("/left/wrench", to_bytes(WrenchSample(0, "workpiece", np.ones(6))), 10**9)
    return directory


REMAP = ["--remap", "wrench:=force/measured"]


@pytest.mark.parametrize(
    "words", [["replay", "BAG", "--recompute"], ["replay", "BAG", "--compensate"], ["report", "BAG", "--out", "OUT"]]
)
def test_a_recording_of_remapped_topics_is_used_with_their_names(remapped, tmp_path, capsys, words):
    words = [{"BAG": str(remapped), "OUT": str(tmp_path)}.get(word, word) for word in words]
    assert main([*words, "--json", *REMAP]) == 0
    answer = json.loads(capsys.readouterr().out)
    if "verdict" in answer:
        assert answer["verdict"] == "identical" and answer["channels"]["/left/wrench"]["compared"] == made.STEPS
    if "passes" in answer:
        assert answer["passes"][0]["complete"] and not answer["passes"][0]["messages_lost"]


def test_a_comparison_takes_the_remapped_force(remapped, tmp_path, capsys):
    cell = tmp_path / "cell.yaml"
    cell.write_text(made.cell_text())
    assert main(["compare", str(remapped), str(cell), *REMAP]) == 0
    assert "force x" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("rule", "sentence"),
    [
        ("wrnch:=force", "'wrnch' is not one of target_trajectory, robot_description, tool_pose, wrench, "),
        ("wrench=force", "'wrench=force' is not NAME:=RECORDED"),
        ("wrench:=force/other", "has no topic force/other"),
    ],
)
def test_a_wrong_remapping_is_one_sentence(remapped, capsys, rule, sentence):
    assert main(["replay", str(remapped), "--recompute", "--remap", rule]) == 2
    error = capsys.readouterr().err
    assert sentence in error and error.count("\n") == 1
