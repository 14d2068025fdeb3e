"""Completion by the shell: commands, and the options of the command that was typed."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

pytest.importorskip("argcomplete", reason="needs the package argcomplete")


@pytest.mark.parametrize(
    ("line", "among", "not_among"),
    [
        ("kr270_milling rep", {"replay", "report"}, {"demo"}),
        ("kr270_milling watch --p", {"--port"}, {"--namespace"}),
        ("kr270_milling compensate paper.yaml --method ", {"linear", "spline"}, {"--out"}),
    ],
)
def test_a_line_is_completed(tmp_path, line, among, not_among):
    answer = tmp_path / "answer"
    asked = {
        "_ARGCOMPLETE": "1", "_ARGCOMPLETE_IFS": "\n", "_ARGCOMPLETE_STDOUT_FILENAME": str(answer), "COMP_LINE": line,
        "COMP_POINT": str(len(line)), "_ARGCOMPLETE_COMP_WORDBREAKS": " \t\n", "_ARGCOMPLETE_SUPPRESS_SPACE": "1",
    }  # fmt: skip
    subprocess.run([sys.executable, "-m", "kr270_milling.cli"], env={**os.environ, **asked}, timeout=120, check=False)
    words = {word.strip() for word in answer.read_text().split("\n")}
    assert among <= words and not words & not_among
