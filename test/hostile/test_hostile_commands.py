"""Every command with files that are none, places that must not change, impossible options, and with Ctrl-C."""

import math
import os
import random
import re
import signal
import stat
import subprocess
import sys
import time
from argparse import ArgumentTypeError
from pathlib import Path

import hypothesis
import numpy as np
import pytest
from budget import budget
from hostile import POSTURE, SHORT, ask, contents, refused, refused_or_sound, settings
from hypothesis import strategies as st
from samples import pass_recording
from samples.recording_samples import record

from kr270_milling.base.arguments import bounded, numbers
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell_file import cell_text, read_cell
from kr270_milling.recordings.bag.writer import BagWriter

GARBAGE = bytes(range(256)) * 40
CONTENTS = {"empty": b"", "garbage": GARBAGE, "text": b"hello\nworld\n", "zeros": bytes(5000)}
PLACES = {"device": "/dev/null", "endless": "/dev/zero", "below a file": f"{__file__}/file",
          "long name": f"{{path}}{'n' * 5000}", "zero byte in the name": "{path}\0"}  # fmt: skip
MAKERS = {
    "missing": lambda path: None,
    "directory": Path.mkdir,
    "pipe": os.mkfifo,
    "circle": lambda path: path.symlink_to(path),
    "sparse": lambda path: (path.touch(), os.truncate(path, 1 << 26 if path.suffix == ".mcap" else 5 << 28)),
}


def made(kind: str, path: Path) -> str:
    """Make a hostile thing at a path; return its name."""
    if kind in CONTENTS:
        path.write_bytes(CONTENTS[kind])
    elif kind in MAKERS:
        MAKERS[kind](path)
    return PLACES.get(kind, "{path}").format(path=path)


COMMANDS = {
    "stiffness": ("stiffness", "{file}", POSTURE),
    "simulate": ("simulate", "{file}", "--out", "{out}"),
    "reference": ("simulate", "paper.yaml", *settings(*SHORT), "--reference", "{file}", "--out", "{out}"),
    "path": ("simulate", "paper.yaml", "--set", "path.file={file}", "--out", "{out}"),
    "compensate": ("compensate", "{file}", "--verdict", "0", "--out", "{out}"),
    "check": ("check", "{file}"),
    "corrected": ("check", "paper.yaml", *settings(*SHORT), "--reference", "{file}"),
    "run": ("run", "{file}", "--out", "{out}"),
    "info": ("info", "{file}"),
    "recompute": ("replay", "{file}", "--recompute"),
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


#: one command for each reader: parameter file, text, recording, recovery, measured signals
@pytest.mark.parametrize("name", ["stiffness", "path", "info", "recover", "UFF"])
@pytest.mark.parametrize("kind", [*CONTENTS, *PLACES, *MAKERS])
def test_every_reader_refuses_what_is_no_such_file_in_one_sentence(name, kind, tmp_path):
    path = made(kind, tmp_path / f"thing{ENDS.get(name, '.mcap')}")
    refused(*[word.format(file=path, out=tmp_path / "out") for word in COMMANDS[name]])
    assert not list(tmp_path.glob("*out*"))


@pytest.mark.skipif(sys.platform != "linux", reason="file names are bytes")
@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_refuses_missing_files_and_garbage_of_any_name(name, tmp_path):
    strange = b"-x\xff\xfea\nb\x1b[2J<b>" + "ä".encode() + ENDS.get(name, ".mcap").encode()
    path = os.fsdecode(os.path.join(os.fsencode(tmp_path), strange))
    words = [word.format(file=path, out=tmp_path / "out") for word in COMMANDS[name]]
    refused(*words)
    Path(path).write_bytes(GARBAGE)
    refused(*words)
    left = contents(tmp_path)
    assert left.pop("out", "dir") == "dir" and list(left.values()) == [GARBAGE]


def test_a_cell_with_a_name_that_is_no_text_is_run(tmp_path):
    """Sentences, tables and files contain the name."""
    folder = os.fsdecode(os.path.join(os.fsencode(tmp_path), b"\xff"))
    os.mkdir(folder)
    cell = Path(folder, os.fsdecode(b"\xfe.yaml"))
    cell.write_text(find_file("paper.yaml").read_text())
    answer = ask("simulate", str(cell), *settings(*SHORT), "--json")
    assert answer.code == 0 and "original" in answer.out, answer
    more = ["--method", "linear", "--verdict", "0", "--out", f"{folder}/out"]
    answer = ask("compensate", str(cell), *settings(*SHORT), *more)
    assert answer.code in (0, 1) and answer.err == "", answer


def test_a_reference_that_is_none_for_this_path_is_refused(tmp_path):
    head = "time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw\n"
    rows = {
        "huge": "0,0,0,0,1,0,0,0\n1,1e30,0,0,1,0,0,0\n",
        "far": "0,0,0,0,1,0,0,0\n0.05,50,0,0,1,0,0,0\n0.06,0,0,0,1,0,0,0\n",
        "longer": "0,-0.01,0,-0.0005,1,0,0,0\n0.07,-0.006,0,-0.0005,1,0,0,0\n",
        "days": "0,0,0,0,1,0,0,0\n9e8,0.01,0,0,1,0,0,0\n",
    }
    for name, text in rows.items():
        file = tmp_path / f"{name}.csv"
        file.write_text(head + text)
        refused("simulate", "paper.yaml", *settings(*SHORT), "--reference", str(file))
        checked = ask("check", "paper.yaml", *settings(*SHORT), "--reference", str(file))
        assert checked.code == 2 or (checked.code == 1 and "must not be run" in checked.out)


SECRET = b"not to be touched"
CELL = ("paper.yaml", *settings(*SHORT))
WRITERS = {name: COMMANDS[name] for name in ("simulate", "compensate", "export", "report", "recover")}
WRITERS["demo"] = ("demo", "--plain", "--out", "{out}")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """What each command that writes reads: a cell, a recording of every topic, or a recording of a whole pass."""
    pytest.importorskip("geometry_msgs")
    directory = tmp_path_factory.mktemp("files")
    cell = directory / "cell.yaml"
    cell.write_text(cell_text(read_cell(find_file("paper.yaml"), (*SHORT, "compensation.method=linear"))))
    record(directory / "topics", 5)
    passed = pass_recording.write(directory / "pass", pass_recording.one_pass())
    topics = dict.fromkeys(("export", "recover"), directory / "topics")
    return topics | {"simulate": cell, "compensate": cell, "report": passed, "demo": ""}


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("place", ["file", "a\0b"])
def test_a_place_that_cannot_be_written_into_is_refused_before_the_work(name, place, files, tmp_path):
    (tmp_path / "file").write_bytes(SECRET)
    refused(*[word.format(out=tmp_path / place, file=files[name]) for word in WRITERS[name]])
    assert contents(tmp_path) == {"file": SECRET}


@pytest.mark.parametrize("name", [name for name in WRITERS if name != "demo"])  # which has no option to be short
def test_files_have_the_permissions_of_the_umask_and_replace_links_but_not_their_targets(name, files, tmp_path):
    """Each file that a command wrote is, the next time, a link to a file elsewhere."""
    out, victim, before = tmp_path / "out", tmp_path / "victim", os.umask(0o027)
    words = [word.format(out=out, file=files[name]) for word in WRITERS[name]]
    try:
        if name != "recover":  # a recording is never written beside other files
            out.mkdir()
            (out / "mine.txt").write_bytes(SECRET)
        answer = ask(*words)
    finally:
        os.umask(before)
    assert answer.code in (0, 1) and answer.err == "", answer
    actual = {file: data for file, data in contents(out).items() if data not in ("dir", SECRET)}
    assert actual and all(actual.values()) and not any(".part" in file for file in actual)
    for path in (out, *out.rglob("*")):
        assert stat.S_IMODE(path.stat().st_mode) == (0o750 if path.is_dir() else 0o640), path
    assert name == "recover" or (out / "mine.txt").read_bytes() == SECRET
    victim.write_bytes(SECRET)
    for file in actual:
        (out / file).unlink()
        (out / file).symlink_to(victim)
    answer = ask(*words)
    assert victim.read_bytes() == SECRET and (answer.code == 2) == (name == "recover")
    assert name == "recover" or not any((out / file).is_symlink() for file in actual)


@pytest.mark.parametrize("command", [["info"], ["replay", "--recompute"], ["export", "--csv", "{out}"]])
def test_texts_of_a_recording_do_not_steer_the_terminal(command, tmp_path):
    pytest.importorskip("geometry_msgs")
    evil = "\x1b[2J\x1b]0;owned\x07\r\n"
    with BagWriter(tmp_path / "a", attachments={f"{evil}.yaml": evil}, metadata={evil: evil}) as writer:
        schema = (f"a/{evil}", "ros2msg", evil.encode())
        writer.add_channel(f"/{evil}", schema, "cdr", {evil: evil})
    answer = ask(command[0], str(tmp_path / "a"), *[word.format(out=tmp_path / "out") for word in command[1:]])
    assert not set("\x1b\x07\r") & set(answer.out + answer.err), answer


# --- options with impossible values ---


NUMBERS = ("", "nan", "inf", "-inf", "1e999", "-1", "9" * 5000, "0x10", "ä", "1;2", "--", "1e30")
COUNTS = ("", "nan", "inf", "1e30", "-1", "0", "1.5", "9" * 5000, "1_0", "0x10", "٣", "²")
SIX = ("", "1", "1,2,3,4,5", "1,2,3,4,5,6,7", "nan,0,0,0,0,0", "0,0,0,0,0,inf", "1e30,0,0,0,0,0", ",,,,,",
       "a,b,c,d,e,f", "-1e300,0,0,0,0,0", "721,0,0,0,0,0")  # fmt: skip


@pytest.mark.parametrize(("parse", "texts"), [
    (numbers(6, 720.0), SIX), (bounded(0.0, 1e6), NUMBERS), (bounded(0.0, 1e6, above=True), (*NUMBERS, "0")),
    (bounded(1, 999999, int), COUNTS),
])  # fmt: skip
def test_a_number_of_an_option_is_finite_within_its_bounds_and_written_in_digits(parse, texts):
    for text in texts:
        with pytest.raises(ArgumentTypeError):
            parse(text)


@pytest.mark.parametrize("words", [
    ["stiffness", "kr270_2.yaml", "--joints-deg=721,0,0,0,0,0"],
    ["stiffness", "kr270_2.yaml", POSTURE, "--wrench=nan,0,0,0,0,0"], ["simulate", *CELL, "--noise-um=nan"],
    ["compensate", *CELL, "--verdict=-1"], ["compensate", *CELL, "--seed=1_0"], ["run", *CELL, "--passes=0"],
    ["compensate", *CELL, "--method=LINEAR"], ["run", *CELL, "--method="], ["compensate", *CELL, "--krl=PTP"],
    ["check", *CELL, "--motion=PTP"],
    *[["replay", "none.mcap", f"{option}=nan"]
      for option in ("--rate", "--start-offset", "--playback-duration", "--clock")],
    ["stiffness", "kr270_2.yaml", "--joints-deg"], ["stiffness", "kr270_2.yaml"], ["stiffness"],
    ["simulate", "paper.yaml", "--set"], ["check", "paper.yaml", "--reference"], ["run"], ["replay"], ["info"],
    ["replay", "a", "--compensate"], ["export"], ["export", "a"], ["recover"], ["report"],
    ["export", "a", "--csv", "x", "--topics"], ["demo", "x"], ["keys", "--steps=3"],
    ["", ""], ["simulate", ""], ["simulate", "paper.yaml", "--set", ""], ["simulate", "paper.yaml", "--set", "="],
    ["simulate", "paper.yaml", "--set", "tool..teeth=3"], ["simulate", "paper.yaml", "--set", "tool=3"],
    ["simulate", "paper.yaml", "--set", "tool.teeth.more=3"], ["simulate", "paper.yaml", "--set", "tool.teeth=[3"],
    ["run", "paper.yaml", "--namespace", "a b", "--out", "/proc/x"],
])  # fmt: skip
def test_a_call_with_a_wrong_value_too_little_or_too_much_is_refused(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused(*words)
    assert contents(tmp_path) == {}


@hypothesis.settings(max_examples=budget(150))
@hypothesis.given(
    st.lists(st.floats(), min_size=6, max_size=6), st.lists(st.floats(), min_size=6, max_size=6), st.booleans()
)
def test_any_posture_under_any_wrench_is_refused_or_has_finite_numbers(joints, wrench, gravity):
    words = [f"--joints-deg={','.join(map(repr, joints))}", f"--wrench={','.join(map(repr, wrench))}"]
    # springs of some 1e7 N m/rad over the square of the condition number that is let through, 1e6
    most = 1e20 if np.abs(wrench).max() < 1e6 else math.inf
    refused_or_sound("stiffness", "kr270_2.yaml", *words, *["--gravity"] * gravity, "--frame", "tool", most=most)


# --- Ctrl-C at any time: exit code 130, one line, no traceback, nothing half written ---


ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2])}
#: prints a line at the start of the command's work, some ten times as long as the paper's pass
STARTED = """
import sys, kr270_milling.cell.jobs as m
real = m.simulate
def reporting(*args, **kwargs):
    print("started", file=sys.stderr, flush=True)
    return real(*args, **kwargs)
m.simulate = reporting
from kr270_milling.cli import main
sys.exit(main(["simulate", "paper.yaml", "--set", "path.feed_rate_m_per_min=0.05", "--out", "out"]))
"""


def test_ctrl_c_ends_a_command_with_one_sentence_and_leaves_the_files_of_the_last_run(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "original.csv").write_text("mine")
    command = [sys.executable, "-c", STARTED]
    with subprocess.Popen(
        command, cwd=tmp_path, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    ) as process:  # fmt: skip
        try:
            assert any(line == "started\n" for line in process.stderr)
            time.sleep(random.uniform(0.0, 0.2))  # the moment is to be any; nothing is waited for
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=30)
        finally:
            process.kill()
    err = re.sub(r"started\n|.*( so far| left): .*\n", "", err)  # and lines of progress, on a busy machine
    assert (process.returncode, err, out) == (130, "kr270_milling: interrupted\n", "")
    assert contents(tmp_path) == {"out": "dir", "out/original.csv": b"mine"}


SIGNALLED = """
import os, signal
from numba.core.compiler_lock import global_compiler_lock as lock
from kr270_milling.cli import _handle_interrupts
_handle_interrupts()

def press():
    os.kill(os.getpid(), signal.{number})
    sum(range(10**6))
    print("still here")

class File:
    def __del__(self):
        press()

def compile():
    with lock:
        press()

try:
    {begin}()
    while True:
        signal.pause()
except {error}:
    print("now")
with lock:
    try:
        os.kill(os.getpid(), signal.{number})
    except {error}:
        print("at once when sent again")
"""


STARTING = """
import os, signal, sys

class Press:
    def find_spec(self, name, *_):
        if name == "kr270_milling.cli":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Press())
from kr270_milling.__main__ import run_program
run_program()
"""


def test_a_signal_waits_for_a_compilation_unless_it_comes_twice_and_a_finalizer_but_not_for_imports():
    def ran(code: str) -> subprocess.CompletedProcess:
        command = [sys.executable, "-c", code]
        return subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, timeout=30)

    for number, error in (("SIGINT", "KeyboardInterrupt"), ("SIGTERM", "SystemExit")):
        for begin in ("compile", "File"):
            done = ran(SIGNALLED.format(number=number, error=error, begin=begin))
            assert (done.stdout, done.stderr) == ("still here\nnow\nat once when sent again\n", "")
    done = ran(STARTING)
    assert (done.returncode, done.stderr) == (130, "kr270_milling: interrupted\n")
