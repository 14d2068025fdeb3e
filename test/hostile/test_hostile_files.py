"""Every command that reads a file, with files that are none: one sentence, exit code 2, nothing written."""

from __future__ import annotations

import os
import sys

import pytest
from hostile import POSTURE, SHORT, ask, contents, refused, settings

GARBAGE = bytes(range(256)) * 40
COMMANDS = {
    "stiffness": ("stiffness", "{file}", POSTURE),
    "simulate": ("simulate", "{file}", "--out", "{out}"),
    "reference": ("simulate", "paper.yaml", *settings(*SHORT), "--reference", "{file}", "--out", "{out}"),
    "path": ("simulate", "paper.yaml", "--set", "path.file={file}", "--out", "{out}"),
    "compensate": ("compensate", "{file}", "--no-verdict", "--out", "{out}"),
    "check": ("check", "{file}"),
    "corrected": ("check", "paper.yaml", *settings(*SHORT), "--reference", "{file}"),
    "run": ("run", "{file}", "--out", "{out}"),
    "info": ("info", "{file}"),
    "recompute": ("replay", "{file}", "--recompute"),
    "revise": ("replay", "{file}", "--compensate", "--out", "{out}"),
    "export": ("export", "{file}", "--csv", "{out}"),
    "report": ("report", "{file}", "--out", "{out}"),
    "recover": ("recover", "{file}", "--out", "{out}"),
    "compliance": ("identify", "compliance", "{file}", "--arm", "kr270_2.yaml", "--out", "{out}"),
    "forces": ("identify", "forces", "{file}", "--cell", "test_piece.yaml", "--out", "{out}"),
    "ring-down": ("identify", "damping", "{file}", "--out", "{out}"),
    "recorded ring-down": ("identify", "damping", "{file}", "--out", "{out}"),
    "UFF": ("identify", "damping", "{file}", "--out", "{out}"),
    "compare": ("compare", "{file}", "paper.yaml", *settings(*SHORT), "--out", "{out}"),
}
ENDS = {"reference": ".csv", "corrected": ".csv", "path": ".nc", "stiffness": ".yaml", "simulate": ".yaml",
        "compensate": ".yaml", "check": ".yaml", "run": ".yaml", "compliance": ".csv", "forces": ".csv",
        "ring-down": ".csv",
        "UFF": ".uff"}  # fmt: skip

KINDS = ("missing", "directory", "empty", "garbage", "text", "zeros", "device", "endless", "pipe", "circle",
         "below a file", "long name", "zero byte in the name", "sparse")  # fmt: skip


def words(name: str, file, out) -> list[str]:
    return [word.format(file=file, out=out) for word in COMMANDS[name]]


def made(kind: str, path):
    """A hostile thing at a place, or in its stead."""
    if kind == "directory":
        path.mkdir()
    elif kind == "device":
        return "/dev/null"
    elif kind == "endless":
        return "/dev/zero"
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "circle":
        path.symlink_to(path)
    elif kind == "below a file":
        path.write_bytes(b"")
        return path / "file"
    elif kind == "long name":
        return path.with_name("n" * 5000)
    elif kind == "zero byte in the name":
        return f"{path}\0"
    elif kind == "sparse":
        with open(path, "wb") as stream:
            stream.truncate(1 << 26 if path.suffix == ".mcap" else 5 << 28)
    elif kind != "missing":
        path.write_bytes({"empty": b"", "garbage": GARBAGE, "text": b"hello\nworld\n", "zeros": bytes(5000)}[kind])
    return path


#: every command with two kinds; one command for each format with every kind
ALL_KINDS = ("simulate", "path", "reference", "info", "recover", "UFF")
CASES = [(name, kind) for name in COMMANDS for kind in KINDS if name in ALL_KINDS or kind in ("missing", "garbage")]


@pytest.mark.parametrize(("name", "kind"), CASES)
def test_what_is_no_such_file_is_told_in_one_sentence(name, kind, tmp_path):
    path = made(kind, tmp_path / f"thing{ENDS.get(name, '.mcap')}")
    before = contents(tmp_path) if kind != "sparse" and kind != "pipe" else None
    refused(*words(name, path, tmp_path / "out"))
    assert not (tmp_path / "out").exists() or not any((tmp_path / "out").iterdir())
    if before is not None:
        (tmp_path / "out").is_dir() and (tmp_path / "out").rmdir()
        assert contents(tmp_path) == before


@pytest.mark.skipif(sys.platform != "linux", reason="file names are bytes")
@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("strange", [b"\xff\xfe", b"a\nb", b"\x1b[2J", b"-x", b"<b>", "ä".encode()])
def test_names_that_are_no_text_do_not_break_the_sentence(name, strange, tmp_path):
    path = os.fsdecode(os.path.join(os.fsencode(tmp_path), strange + ENDS.get(name, ".mcap").encode()))
    refused(*words(name, path, tmp_path / "out"))
    with open(path, "wb") as stream:
        stream.write(GARBAGE)
    refused(*words(name, path, tmp_path / "out"))


def test_a_cell_with_a_name_that_is_no_text_is_run(tmp_path):
    """Sentences, tables and files name it somehow."""
    from kr270_milling.base.record import find_file

    folder = os.path.join(os.fsencode(tmp_path), b"\xff")
    os.mkdir(folder)
    cell = os.fsdecode(os.path.join(folder, b"\xfe.yaml"))
    text = find_file("paper.yaml").read_text()
    with open(cell, "w") as stream:
        stream.write(text)
    for more in ([], ["--json"]):
        answer = ask("simulate", cell, *settings(*SHORT), "--out", os.fsdecode(folder + b"/out"), *more)
        assert answer.code == 0 and "original" in answer.out, answer
    answer = ask(
        "compensate",
        cell,
        *settings(*SHORT),
        "--method",
        "linear",
        "--no-verdict",
        "--out",
        os.fsdecode(folder + b"/more"),
    )
    assert answer.code in (0, 1) and answer.err == "", answer


def test_a_reference_that_is_none_for_this_path_is_refused(tmp_path):
    """Huge, backward and unfinished tables."""
    head = "time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw\n"
    rows = {
        "huge": "0,0,0,0,1,0,0,0\n1,1e30,0,0,1,0,0,0\n",
        "far": "0,0,0,0,1,0,0,0\n0.05,50,0,0,1,0,0,0\n0.06,0,0,0,1,0,0,0\n",
        "longer": "0,-0.01,0,-0.0005,1,0,0,0\n0.07,-0.006,0,-0.0005,1,0,0,0\n",
        "days": "0,0,0,0,1,0,0,0\n9e8,0.01,0,0,1,0,0,0\n",
        "backward": "0,0,0,0,1,0,0,0\n-1,0.1,0,0,1,0,0,0\n",
        "infinite": "0,0,0,0,1,0,0,0\n1,inf,0,0,1,0,0,0\n",
        "turned": "0,0,0,0,0,0,0,0\n1,0.1,0,0,1,0,0,0\n",
        "cut off": "0,0,0,0,1,0,0,0\n1,0.1,0,0,1,0",
    }
    for name, text in rows.items():
        file = tmp_path / f"{name}.csv"
        file.write_text(head + text)
        refused("simulate", "paper.yaml", *settings(*SHORT), "--reference", str(file))
        checked = ask("check", "paper.yaml", *settings(*SHORT), "--reference", str(file))
        assert checked.code == 2 or (checked.code == 1 and "must not be run" in checked.out)
