"""What is removed from /dev/shm behind a graph, and what is not."""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from kr270_milling.graph import litter

#: runs a command that sees no other process, as in a container that shares /dev/shm
ALONE = ["unshare", "--pid", "--fork", "--mount-proc"]
REMOVE = "from kr270_milling.graph.litter import remove_litter; print('\\n'.join(remove_litter([])))"


def alone() -> bool:
    try:
        return subprocess.run([*ALONE, "true"], capture_output=True, timeout=10).returncode == 0
    except OSError:
        return False


@pytest.fixture
def port(ros_environment, domain):
    """The name of a port of this domain that no node takes; what the test has made of it goes."""
    name = f"/dev/shm/fastrtps_port{7400 + 250 * domain + 249}"
    yield name
    for file in (name, name + "_el", name + "_sl", f"/dev/shm/sem.{Path(name).name}_mutex"):
        Path(file).unlink(missing_ok=True)


def make(port: str, *kinds: str) -> list[str]:
    files = [port, *(port + kind for kind in kinds), f"/dev/shm/sem.{Path(port).name}_mutex"]
    for file in files:
        Path(file).touch()
    return sorted(files)


@pytest.mark.skipif(not alone(), reason="no process may be made here that does not see the others")
@pytest.mark.parametrize("kind", ["_el", "_sl"])
def test_port_of_a_node_that_is_not_seen_from_here_is_left_alone(port, kind):
    files = make(port, kind)
    command = [*ALONE, sys.executable, "-c", REMOVE]
    with open(port + kind) as lock:
        fcntl.flock(lock, fcntl.LOCK_SH if kind == "_sl" else fcntl.LOCK_EX)
        assert port not in subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout
        assert all(map(os.path.exists, files))
    gone = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout.split()
    assert gone == files and not any(map(os.path.exists, files))


@pytest.mark.skipif(shutil.which("flock") is None, reason="no program that locks a file")
def test_port_without_a_lock_is_left_alone_where_it_was_just_in_the_making(port):
    files = make(port)
    with subprocess.Popen(
        ["sh", "-c", f"sleep {0.3 * litter.MAKING}; exec flock --no-fork {port}_el sleep 60"]
    ) as maker:
        assert not set(files) & set(litter.remove_litter([]))
        maker.kill()
    assert {*files, port + "_el"} <= set(litter.remove_litter([]))
