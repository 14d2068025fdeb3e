"""Helpers of the tests with hostile input: commands run in this process, and the checks of every answer."""

import contextlib
import io
import json
import os
import time
from pathlib import Path
from typing import NamedTuple

import pytest
from json_keys import answer_of

from kr270_milling.cli import main
from kr270_milling.show.commands.options import make_parser, run

POSTURE = "--joints-deg=90,-50,120,180,25,180"
#: a pass of 120 exchanges
SHORT = ("path.length_mm=4", "stock.grid_step_um=20", "stock.max_mm=[4,12,0]")
LONGEST = 20.0  # [s] of the processor that any command here may take


class Answer(NamedTuple):
    """Exit code and output of a command."""

    code: int
    out: str
    err: str


def ask(*words: str) -> Answer:
    """Run a command; only exit codes 0, 1 and 2 may come, and no exception."""
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8") for _ in range(2))
    begin = time.process_time()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(list(words))
    assert time.process_time() - begin < LONGEST
    texts = []
    for stream in (out, err):
        stream.flush()
        texts.append(stream.buffer.getvalue().decode())
    assert code in (0, 1, 2), texts
    return Answer(code, *texts)


def answered(*words: str, code: int = 0) -> dict:
    """The JSON object of a command; beside it only the caution of a decision may be printed."""
    answer = ask(*map(str, words), "--json")
    assert answer.code == code, answer
    return parsed(answer)


def printed(capsys, *words: str) -> tuple[int, str, dict, str]:
    """Run a command once; return its exit code, what it prints for a reader, its JSON, and its warnings."""
    answer = run(make_parser(words).parse_args(words))
    with answer_of(words[0]):
        code = answer.print(as_json=True)
    text, warnings = capsys.readouterr()
    assert answer.print(as_json=False) == code
    return code, capsys.readouterr().out, json.loads(text), warnings


def parsed(answer: Answer) -> dict:
    assert answer.err == "" or answer.err.startswith("warning: decision: caution: "), answer.err
    return json.loads(answer.out, parse_constant=lambda c: pytest.fail(f"{c} is no JSON"))


def refused(*words: str) -> str:
    """The one sentence about a command that exits with 2."""
    answer = ask(*words)
    assert answer.code == 2 and answer.out == "", answer
    sentence = answer.err.removesuffix("\n")
    assert sentence.startswith("kr270_milling: ") and sentence.isprintable(), answer.err
    return sentence


def refused_or_sound(*words: str, most: float = 1e15) -> Answer:
    """A command with --json either refuses in one sentence or gives numbers that can be, of at most a size."""
    answer = ask(*words, "--json")
    if answer.code == 2:
        refusal = json.loads(answer.out)
        assert refusal["exit_code"] == 2 and refusal["error"].isprintable() and answer.err == "", answer
        return answer
    for key, value in _numbers(parsed(answer)):
        if key != ".findings.value":  # a stop says how far beyond its limit, however far that is
            assert abs(value) < most, f"{key} is {value}"
    return answer


def _numbers(value, key: str = ""):
    if isinstance(value, dict):
        for name, item in value.items():
            yield from _numbers(item, f"{key}.{name}")
    elif isinstance(value, list):
        for item in value:
            yield from _numbers(item, key)
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield key, value


def contents(directory) -> dict[str, bytes | str]:
    """Everything below a directory by its relative name: bytes of files, "dir", "-> target" of links."""
    entries = {}
    for path in sorted(Path(directory).rglob("*")):
        name = str(path.relative_to(directory))
        entries[name] = (
            f"-> {os.readlink(path)}" if path.is_symlink() else "dir" if path.is_dir() else path.read_bytes()
        )
    return entries


def settings(*assignments: str) -> list[str]:
    return [word for text in assignments for word in ("--set", text)]
