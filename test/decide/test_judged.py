"""Programs that must or must not be stopped: each file has the answer of ``check`` (see judged/README.md)."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from hostile import ask, settings

from kr270_milling.decide.findings import KINDS

FOLDER = Path(__file__).with_name("judged")
FILES = sorted(path for path in FOLDER.glob("*/*") if path.is_file())
MARK = re.compile(r"\((expect|set): (.*?)\)[ \t\r]*$", re.M)
STOP, REFUSED, MAY_BE_RUN = "stop ", "refused ", "may be run"


def judged(file: Path, folder: Path) -> tuple[str, set[str] | str]:
    """The expected answer of a file, and the kinds of the stops or the sentence of the refusal."""
    text = file.read_text()
    marks = MARK.findall(text)
    (expected,) = (value for key, value in marks if key == "expect")
    program, cell = folder / file.name, folder / "cell.yaml"
    program.write_text(MARK.sub("", text))  # every line keeps its number, and no mark is a comment of the program
    commands = [
        ("init", "--gcode", str(program), "--out", str(cell)),
        ("check", str(cell), *settings(*(value for key, value in marks if key == "set"))),
    ]
    for words in commands:
        answer = ask(*words, "--json")
        values = json.loads(answer.out)
        if answer.code == 2:
            return expected, values["error"]
    tools = values.get("tools", {"": values}).values()
    return expected, {f["what"] for tool in tools for f in tool["findings"] if f["severity"] == "stop"}


@pytest.mark.parametrize("file", FILES, ids=lambda file: f"{file.parent.name}/{file.name}")
def test_a_program_gets_the_answer_that_its_file_expects(file, tmp_path):
    expected, answer = judged(file, tmp_path)
    if expected == MAY_BE_RUN:
        assert file.parent.name == "sound" and answer == set()
    elif expected.startswith(REFUSED):
        assert file.parent.name == "dangerous" and expected.removeprefix(REFUSED) in answer
    else:
        kind = expected.removeprefix(STOP)
        assert file.parent.name == "dangerous" and kind in KINDS and kind in answer
