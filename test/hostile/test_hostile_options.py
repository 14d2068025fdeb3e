"""Options with impossible values, in every command: exit code 2 and no pass."""

from __future__ import annotations

import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from budget import budget
from hostile import POSTURE, SHORT, ask, contents, refused, refused_or_sound, settings
from hypothesis import HealthCheck, given
from hypothesis import settings as examples
from hypothesis import strategies as st

NUMBERS = ("", "nan", "inf", "-inf", "1e999", "-1", "9" * 5000, "0x10", "ä", "1;2", "--", "1e30")
COUNTS = ("", "nan", "inf", "1e30", "-1", "0", "1.5", "9" * 5000, "1_0", "0x10", "٣", "²")
SIX = ("", "1", "1,2,3,4,5", "1,2,3,4,5,6,7", "nan,0,0,0,0,0", "0,0,0,0,0,inf", "1e30,0,0,0,0,0", ",,,,,",
       "a,b,c,d,e,f", "-1e300,0,0,0,0,0", "721,0,0,0,0,0")  # fmt: skip
CELL = ("paper.yaml", *settings(*SHORT))


@pytest.mark.parametrize("text", SIX)
def test_joints_and_wrenches_that_no_arm_has_are_refused(text):
    refused("stiffness", "kr270_2.yaml", "--joints-deg", text)
    refused("stiffness", "kr270_2.yaml", f"--joints-deg={text}")
    if text != "721,0,0,0,0,0":
        refused("stiffness", "kr270_2.yaml", POSTURE, f"--wrench={text}")


@pytest.mark.parametrize(("command", "option", "values"), [
    ("compensate", "--verdict", COUNTS), ("compensate", "--seed", COUNTS), ("run", "--passes", COUNTS),
    ("compensate", "--method", ("", "fastest", "LINEAR")), ("run", "--method", ("", "best")),
    ("compensate", "--krl", ("", "PTP")), ("check", "--motion", ("", "PTP")),
])  # fmt: skip
def test_counts_and_choices_are_held_to_what_they_may_be(command, option, values, tmp_path):
    for value in values:
        out = ["--out", str(tmp_path / "out")] if command != "check" else []
        refused(command, *CELL, f"{option}={value}", *out)
    assert contents(tmp_path) == {}


@pytest.mark.parametrize("option", ["--rate", "--start-offset", "--playback-duration", "--delay", "--clock"])
@pytest.mark.parametrize("value", NUMBERS)
def test_playback_takes_no_number_that_is_none(option, value, tmp_path, monkeypatch):
    """The file is missing: a number that is taken (or an empty one, which is no option's value) ends there."""
    pytest.importorskip("rclpy")
    monkeypatch.setattr("sys.argv", ["kr270_milling"])  # the player calls itself by the name of its program
    refused("replay", str(tmp_path / "none.mcap"), f"{option}={value}")


@pytest.mark.parametrize("words", [
    ["stiffness", "kr270_2.yaml", "--joints-deg"], ["stiffness", "kr270_2.yaml"], ["stiffness"],
    ["simulate", "paper.yaml", "--set"], ["simulate", "paper.yaml", "--out"], ["simulate", "paper.yaml", "--reference"],
    ["compensate", "paper.yaml", "--method"], ["compensate", "paper.yaml", "--out"],
    ["compensate", "paper.yaml", "--seed"],
    ["check"], ["check", "paper.yaml", "--reference"], ["run"], ["run", "paper.yaml", "--passes"], ["demo", "--out"],
    ["replay"], ["replay", "a", "--recompute", "--compensate"], ["replay", "a", "--rate"], ["info"], ["info", "a", "b"],
    ["export"], ["export", "a"], ["export", "a", "--csv"], ["export", "a", "--csv", "x", "--topics"], ["recover"],
    ["report"], ["bench", "x"], ["demo", "x"], ["bench", "--steps=3"],
    ["", ""], ["simulate", ""], ["simulate", "paper.yaml", "--set", ""], ["simulate", "paper.yaml", "--set", "="],
    ["simulate", "paper.yaml", "--set", "tool..teeth=3"], ["simulate", "paper.yaml", "--set", "tool=3"],
    ["simulate", "paper.yaml", "--set", "tool.teeth.more=3"], ["simulate", "paper.yaml", "--set", "tool.teeth=[3"],
    ["run", "paper.yaml", "--namespace", "a b", "--out", "/proc/x"],
])  # fmt: skip
def test_a_call_that_misses_something_or_has_too_much_is_refused(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused(*words)
    assert contents(tmp_path) == {}


@examples(max_examples=budget(150), deadline=None, suppress_health_check=list(HealthCheck))
@given(st.lists(st.floats(), min_size=6, max_size=6), st.lists(st.floats(), min_size=6, max_size=6), st.booleans())
def test_any_posture_under_any_wrench_is_refused_or_has_finite_numbers(joints, wrench, gravity):
    words = [f"--joints-deg={','.join(map(repr, joints))}", f"--wrench={','.join(map(repr, wrench))}"]
    answer = ask("stiffness", "kr270_2.yaml", *words, *["--gravity"] * gravity, "--json")
    assert answer.code in (0, 2)


@examples(max_examples=budget(60), deadline=None, suppress_health_check=list(HealthCheck))
@given(st.lists(st.floats(-720, 720), min_size=6, max_size=6), st.lists(st.floats(-1e6, 1e6), min_size=6, max_size=6))
def test_any_posture_that_can_be_has_numbers_that_can_be(joints, wrench):
    words = [f"--joints-deg={','.join(map(repr, joints))}", f"--wrench={','.join(map(repr, wrench))}"]
    # springs of some 1e7 N m/rad over the square of the condition number that is let through, 1e6
    refused_or_sound("stiffness", "kr270_2.yaml", *words, "--frame", "tool", most=1e20)


# --- Ctrl-C at any time: exit code 130, one line, no traceback, nothing half written ---


ROOT = Path(__file__).resolve().parents[2]
#: prints a line at the start of the command's work, at the first function that all commands call
STARTED = """
import sys, kr270_milling.{module} as m
real = m.{name}
def reporting(*args, **kwargs):
    print("started", file=sys.stderr, flush=True)
    return real(*args, **kwargs)
m.{name} = reporting
from kr270_milling.cli import main
sys.exit(main({words!r}))
"""
LONG = ["--set", "path.feed_rate_m_per_min=0.05"]  # some ten times as long as the paper's pass
COMMANDS = {
    "simulate": (["simulate", "paper.yaml", *LONG, "--out", "out"], "cell.jobs", "simulate"),
    "compensate": (["compensate", "paper.yaml", *LONG, "--method=learned", "--out=out"], "cell.jobs", "simulate"),
    "demo": (["demo", "--plain", "--out", "out"], "cell.jobs", "simulate"),
}


def interrupted(directory, words, module, name, delay: float) -> subprocess.CompletedProcess:
    """Start a command, and press Ctrl-C a little after the start of its work."""
    code = STARTED.format(words=words, module=module, name=name)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        [sys.executable, "-c", code], cwd=directory, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, start_new_session=True,
    ) as process:  # fmt: skip
        try:
            assert any(line == "started\n" for line in process.stderr)
            time.sleep(delay)  # the moment is to be any; nothing is waited for
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=30)
        finally:
            process.kill()
    err = re.sub(r"started\n|.*( so far| left): .*\n", "", err)  # and lines of progress, on a busy machine
    return subprocess.CompletedProcess(words, process.returncode, out, err)


@pytest.mark.parametrize("name", ["compensate", "demo"])
def test_ctrl_c_ends_a_command_cleanly(name, tmp_path):
    words, module, function = COMMANDS[name]
    ended = interrupted(tmp_path, words, module, function, random.Random(name).uniform(0.0, 0.4))
    assert (ended.returncode, ended.stderr, ended.stdout) == (130, "kr270_milling: interrupted\n", "")
    assert contents(tmp_path) == {}


def test_ctrl_c_leaves_the_files_of_the_last_run_as_they_were(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "original.csv").write_text("mine")
    ended = interrupted(tmp_path, *COMMANDS["simulate"], 0.1)
    assert ended.returncode == 130
    assert contents(tmp_path) == {"out": "dir", "out/original.csv": b"mine"}


def test_ctrl_c_while_files_are_written_leaves_none(tmp_path):
    words = ["demo", "--plain", "--out", "out"]
    ended = interrupted(tmp_path, words, "show.report", "write_report", random.Random("report").uniform(0.0, 0.05))
    if ended.returncode != 0:  # quicker than the key
        assert (ended.returncode, ended.stderr, ended.stdout) == (130, "kr270_milling: interrupted\n", "")
        assert contents(tmp_path) == {}
    else:
        assert not [name for name in contents(tmp_path) if "part" in name]


COMPILING = """
import os, signal
from numba.core.compiler_lock import global_compiler_lock as lock
from kr270_milling.cli import _handle_interrupts
_handle_interrupts()
with lock:
    os.kill(os.getpid(), signal.SIGINT)
    sum(range(10**6))
    print("still here")
try:
    while True:
        signal.pause()
except KeyboardInterrupt:
    print("now")
with lock:
    try:
        os.kill(os.getpid(), signal.SIGINT)
    except KeyboardInterrupt:
        print("at once when pressed again")
"""


def test_ctrl_c_waits_for_a_compilation_unless_it_comes_twice(tmp_path):
    ran = subprocess.run(
        [sys.executable, "-c", COMPILING], env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
        timeout=30,
    )  # fmt: skip
    assert ran.stdout.split("\n") == ["still here", "now", "at once when pressed again", ""], ran.stderr


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


def test_ctrl_c_before_the_command_line_is_imported_prints_one_sentence():
    ran = subprocess.run([sys.executable, "-c", STARTING], cwd=ROOT, capture_output=True, text=True, timeout=30)
    assert (ran.returncode, ran.stderr) == (130, "kr270_milling: interrupted\n")
