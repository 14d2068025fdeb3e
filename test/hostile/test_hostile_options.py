"""Options with impossible values, in every command: exit code 2 and no pass."""

from __future__ import annotations

import math
import os
import random
import re
import signal
import subprocess
import sys
import time
from argparse import ArgumentTypeError
from pathlib import Path

import numpy as np
import pytest
from budget import budget
from hostile import POSTURE, SHORT, contents, refused, refused_or_sound, settings
from hypothesis import HealthCheck, given
from hypothesis import settings as examples
from hypothesis import strategies as st

from kr270_milling.base.arguments import bounded, numbers

NUMBERS = ("", "nan", "inf", "-inf", "1e999", "-1", "9" * 5000, "0x10", "ä", "1;2", "--", "1e30")
COUNTS = ("", "nan", "inf", "1e30", "-1", "0", "1.5", "9" * 5000, "1_0", "0x10", "٣", "²")
SIX = ("", "1", "1,2,3,4,5", "1,2,3,4,5,6,7", "nan,0,0,0,0,0", "0,0,0,0,0,inf", "1e30,0,0,0,0,0", ",,,,,",
       "a,b,c,d,e,f", "-1e300,0,0,0,0,0", "721,0,0,0,0,0")  # fmt: skip
CELL = ("paper.yaml", *settings(*SHORT))


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
    ["stiffness", "kr270_2.yaml", POSTURE, "--wrench=nan,0,0,0,0,0"],
    ["compensate", *CELL, "--verdict=-1"], ["compensate", *CELL, "--seed=1_0"], ["run", *CELL, "--passes=0"],
    ["compensate", *CELL, "--method=LINEAR"], ["run", *CELL, "--method="], ["compensate", *CELL, "--krl=PTP"],
    ["check", *CELL, "--motion=PTP"],
    *[["replay", "none.mcap", f"{option}=nan"]
      for option in ("--rate", "--start-offset", "--playback-duration", "--delay", "--clock")],
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
def test_a_call_with_a_wrong_value_too_little_or_too_much_is_refused(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused(*words)
    assert contents(tmp_path) == {}


@examples(max_examples=budget(150), deadline=None, suppress_health_check=list(HealthCheck))
@given(st.lists(st.floats(), min_size=6, max_size=6), st.lists(st.floats(), min_size=6, max_size=6), st.booleans())
def test_any_posture_under_any_wrench_is_refused_or_has_finite_numbers(joints, wrench, gravity):
    words = [f"--joints-deg={','.join(map(repr, joints))}", f"--wrench={','.join(map(repr, wrench))}"]
    # springs of some 1e7 N m/rad over the square of the condition number that is let through, 1e6
    most = 1e20 if np.abs(wrench).max() < 1e6 else math.inf
    refused_or_sound("stiffness", "kr270_2.yaml", *words, *["--gravity"] * gravity, "--frame", "tool", most=most)


# --- Ctrl-C at any time: exit code 130, one line, no traceback, nothing half written ---


ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2])}
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


def test_ctrl_c_ends_a_command_with_one_sentence_and_leaves_the_files_of_the_last_run(tmp_path):
    words = ["simulate", "paper.yaml", "--set", "path.feed_rate_m_per_min=0.05", "--out", "out"]  # ten times as long
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "original.csv").write_text("mine")
    command = [sys.executable, "-c", STARTED.format(module="cell.jobs", name="simulate", words=words)]
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


COMPILING = """
import os, signal
from numba.core.compiler_lock import global_compiler_lock as lock
from kr270_milling.cli import _handle_interrupts
_handle_interrupts()
with lock:
    os.kill(os.getpid(), signal.{number})
    sum(range(10**6))
    print("still here")
try:
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


def ran(code: str) -> subprocess.CompletedProcess:
    command = [sys.executable, "-c", code]
    return subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, timeout=30)


@pytest.mark.parametrize("number, error", [("SIGINT", "KeyboardInterrupt"), ("SIGTERM", "SystemExit")])
def test_a_signal_waits_for_a_compilation_unless_it_comes_twice(number, error):
    done = ran(COMPILING.format(number=number, error=error))
    assert done.stdout.split("\n") == ["still here", "now", "at once when sent again", ""], done.stderr


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
    done = ran(STARTING)
    assert (done.returncode, done.stderr) == (130, "kr270_milling: interrupted\n")
