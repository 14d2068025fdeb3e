"""The pages of the folders report and watch: their commands run, their links and names exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hostile import ask

from kr270_milling.cli import _parser

ROOT = Path(__file__).resolve().parents[3]


def commands(folder: str, language: str) -> list[list[str]]:
    text = (ROOT / "kr270_milling" / folder / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)
    return [line.split()[1:] for block in blocks for line in block.splitlines() if line.startswith("kr270_milling ")]


def test_the_commands_of_the_report_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for words in commands("show/report", "sh"):
        assert ask(*words).code == 0
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "kr270_milling demo --plain --out out" in page


@pytest.mark.parametrize(("folder", "language"), [("show/report", "text"), ("live/watch", "sh")])
def test_the_other_commands_are_understood(folder, language):
    result = commands(folder, language)
    assert result
    for words in result:
        assert _parser(words).parse_args(words).command == words[0]


@pytest.mark.parametrize("folder", ["show/report", "live/watch"])
def test_the_files_that_are_named_exist(folder):
    text = (ROOT / "kr270_milling" / folder / "README.md").read_text(encoding="utf-8")
    for name in re.findall(r"`((?:config/)[\w.]+)`", text):
        assert (ROOT / name).is_file(), name
