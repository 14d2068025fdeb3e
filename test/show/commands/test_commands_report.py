"""The command report: which recordings it takes and where it writes."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import pass_recording as made
from hostile import ask, refused

from kr270_milling.cli import main
from kr270_milling.exchange.replay.recorded import pass_from_recording
from kr270_milling.show.commands.recordings import unique_names

pytestmark = made.needs_messages


def test_the_report_of_a_directory_goes_into_it_whether_it_holds_files_or_directories(tmp_path):
    recording = made.write(tmp_path / "made" / "one", made.one_pass()) / "one.mcap"
    for place in ("files/a.mcap", "files/b.mcap", "directories/a/a.mcap"):
        (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(recording, tmp_path / place)
    for place in ("files", "directories"):
        assert ask("report", str(tmp_path / place)).code == 0
    assert pages(tmp_path) == ["directories/report/report.html", "files/report/report.html"]


def test_the_report_of_a_file_goes_beside_it(tmp_path):
    recording = made.write(tmp_path / "one", made.one_pass()) / "one.mcap"
    assert ask("report", str(recording)).code == 0
    assert pages(tmp_path) == ["one/report/report.html"]


def pages(directory: Path) -> list[str]:
    return sorted(str(page.relative_to(directory)) for page in directory.rglob("report.html"))


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


def test_passes_of_two_paths_are_not_compared(tmp_path, monkeypatch):
    def another_path(path, *names):
        outcome = pass_from_recording(path, *names)
        longer = outcome.cell.replace(path=outcome.cell.path.replace(length=2 * outcome.cell.path.length))
        return outcome if path.parent.name == "a" else dataclasses.replace(outcome, cell=longer, scored=other.scored)

    first, second = (made.write(tmp_path / name, made.one_pass()) for name in "ab")
    other = pass_from_recording(made.write(tmp_path / "c", made.one_pass("spline", passes=1)) / "c.mcap")
    shifted = dataclasses.replace(other.scored.result, wrench=other.scored.result.wrench + 1.0)
    other = dataclasses.replace(other, scored=dataclasses.replace(other.scored, result=shifted))
    monkeypatch.setattr("kr270_milling.exchange.replay.recorded.pass_from_recording", another_path)
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
