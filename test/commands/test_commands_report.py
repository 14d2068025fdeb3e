"""The command report: which recordings it takes and where it writes."""

from __future__ import annotations

import shutil
from pathlib import Path

import pass_recording as made
from hostile import ask, refused

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
