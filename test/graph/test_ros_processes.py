"""What is removed from /dev/shm before and behind a graph, and what is not."""

from __future__ import annotations

import fcntl
import mmap
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from kr270_milling.ros import litter

#: runs a command that sees no other process, as in a container that shares /dev/shm
ALONE = ["unshare", "--pid", "--fork", "--mount-proc"]
REMOVE = "from kr270_milling.ros.litter import remove_litter; print('\\n'.join(remove_litter()))"
#: a node that is up and waits
NODE = """
import rclpy, time
from kr270_milling.ros.environment import keep_to_this_host
keep_to_this_host()
rclpy.init()
node = rclpy.create_node("forgotten")
print("up", flush=True)
time.sleep(60)
"""


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
    """Files as Fast DDS makes them; its mutex is a semaphore that is free."""
    files = [port, *(port + kind for kind in kinds), f"/dev/shm/sem.{Path(port).name}_mutex"]
    for file in files:
        Path(file).write_bytes((1).to_bytes(32, "little"))
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
    assert set(files) <= set(gone) and not any(map(os.path.exists, files))


@pytest.mark.parametrize("value", [0, 1], ids=["taken", "free"])
def test_port_without_a_lock_is_left_alone_while_somebody_opens_it(port, value):
    files = make(port)
    Path(f"/dev/shm/sem.{Path(port).name}_mutex").write_bytes(value.to_bytes(32, "little"))
    assert set(files) <= set(litter.remove_litter()) if value else not set(files) & set(litter.remove_litter())
    for file in filter(os.path.exists, files):
        os.utime(file, (0, 0))
    litter.remove_litter()  # whoever opened it is dead
    assert not any(map(os.path.exists, files))


def test_port_that_waits_for_its_listener_stays_while_a_sender_has_it_mapped(port):
    """A listener that made it anew would never hear that sender: nodes of another graph did not find each other."""
    files = make(port)
    with open(port, "r+b") as stream, mmap.mmap(stream.fileno(), 0):
        assert not set(files) & set(litter.remove_litter())
    assert set(files) <= set(litter.remove_litter())


def test_segment_without_a_lock_is_left_alone_while_it_may_be_in_the_making():
    segment = Path("/dev/shm/fastrtps_0123456789abcdef")
    segment.touch()
    assert str(segment) not in litter.remove_litter()
    os.utime(segment, (0, 0))
    assert str(segment) in litter.remove_litter()


def test_lock_whose_file_was_removed_and_made_anew_is_that_of_another(port, monkeypatch):
    """As when somebody takes a dead port for himself while this process looks at it."""
    files = make(port, "_el")
    plain = fcntl.flock

    def flock(lock, how):
        Path(port + "_el").unlink()
        Path(port + "_el").touch()
        plain(lock, how)

    monkeypatch.setattr(fcntl, "flock", flock)
    assert not set(files) & set(litter.remove_litter())


def test_what_a_killed_node_leaves_goes_and_a_living_one_keeps_all(ros_environment):
    nodes = [
        subprocess.Popen([sys.executable, "-c", NODE], env=ros_environment, stdout=subprocess.PIPE) for _ in range(2)
    ]
    try:
        assert all(node.stdout.readline() == b"up\n" for node in nodes)
        dead, living = (locks_of(node.pid) for node in nodes)
        nodes[0].send_signal(signal.SIGKILL)
        nodes[0].wait()
        assert len(dead) >= 2 and dead <= set(litter.remove_litter())
        assert len(living) >= 2 and all(map(os.path.exists, living))
    finally:
        for node in nodes:
            node.kill()
            node.communicate()


def test_what_the_middleware_says_is_not_in_the_output_of_a_program(ros_environment, domain):
    """It would make JSON unreadable. Here the first port of the domain cannot be had."""
    lock = Path(f"/dev/shm/fastrtps_port{7400 + 250 * domain + 11}_el")
    with open(lock, "w") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        node = subprocess.Popen(
            [sys.executable, "-c", NODE], env=ros_environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        try:
            assert node.stdout.readline() == "up\n"
        finally:
            node.kill()
            rest, told = node.communicate()
            lock.unlink()
    assert "Failed init_port" in told and not rest


def locks_of(pid: int) -> set[str]:
    places = [Path(entry) for entry in Path(f"/proc/{pid}/fd").iterdir()]
    return {name for name in map(os.readlink, places) if name.startswith(litter.SHARED + "fastrtps_")}
