"""Ctrl-C at any time: exit code 130, one line, no traceback, nothing half written."""

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
from hostile import contents

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
    err = re.sub(r"started\n|.*: .*( so far| left)\n", "", err)  # and lines of progress, on a busy machine
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
