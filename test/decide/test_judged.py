"""Programs that must or must not be stopped: each file has the answer of ``check`` (see judged/README.md)."""

import json
import re
from pathlib import Path

import pytest
from hostile import ask, settings
from samples.small_part import GCODE, LEANING, compile_cut

from kr270_milling.decide.check import check
from kr270_milling.decide.findings import KINDS

FOLDER = Path(__file__).with_name("judged")
FILES = sorted(path for path in FOLDER.glob("*/*") if path.is_file())
MARK = re.compile(r"\((expect|set): (.*?)\)[ \t\r]*$", re.M)
STOP, WARNING, REFUSED, MAY_BE_RUN = "stop ", "warning ", "refused ", "may be run"


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """Compile the models once, which takes longer than a command may take."""
    for gcode in (GCODE, LEANING):
        check(compile_cut("engagement", gcode=gcode))


def judged(file: Path, folder: Path) -> tuple[str, str, list[dict]]:
    """The expected answer of a file, the sentence of a refusal and the findings."""
    text = file.read_text(encoding="utf-8", errors="replace")
    marks = MARK.findall(text)
    (expected,) = (value for key, value in marks if key == "expect")
    program, cell = folder / file.name, folder / "cell.yaml"
    program.write_text(
        MARK.sub("", text), encoding="utf-8"
    )  # every line keeps its number, no mark is a comment on tools
    commands = [
        ("init", "--gcode", str(program), "--out", str(cell)),
        ("check", str(cell), *settings(*(value for key, value in marks if key == "set"))),
    ]
    for words in commands:
        answer = ask(*words, "--json")
        values = json.loads(answer.out)
        if answer.code == 2:
            return expected, values["error"], []
    tools = values.get("tools", [values])
    return expected, "", [finding for tool in tools for finding in tool["findings"]]


@pytest.mark.parametrize("file", FILES, ids=lambda file: f"{file.parent.name}/{file.name}")
def test_a_program_gets_the_answer_that_its_file_expects(file, tmp_path):
    expected, refusal, findings = judged(file, tmp_path)
    stops, warnings = ({f["what"] for f in findings if f["severity"] == word} for word in ("stop", "warning"))
    sound = expected == MAY_BE_RUN or expected.startswith(WARNING)
    assert file.parent.name == ("sound" if sound else "dangerous")
    assert not sound or not (stops or refusal), (stops, refusal)
    if expected.startswith(REFUSED):
        assert expected.removeprefix(REFUSED) in refusal
    for word, kinds in ((STOP, stops), (WARNING, warnings)):
        if expected.startswith(word):
            assert expected.removeprefix(word) in KINDS and expected.removeprefix(word) in kinds, refusal
