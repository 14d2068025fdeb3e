"""A ROS domain id that no other process on this machine uses, another id for every test; messages as records."""

import contextlib
import fcntl
import itertools
import os
import subprocess
import tempfile
from pathlib import Path

import pytest

from kr270_milling.recordings.messages.codec import from_bytes

#: what a shell may have set about discovery
DISCOVERY = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "ROS_AUTOMATIC_DISCOVERY_RANGE")
ROOT = Path(__file__).resolve().parents[1]
PORTS = 7400, 250  # first UDP port of domain 0, and ports of a domain (RTPS, section 9.6.1)
COUNT = 100  # domains; from 102 on their ports may be those of any program
_turn = itertools.count(os.getpid())  # the rest of one test is not in the domain of the next


def _locks() -> Path:
    """A folder of files to lock: the kernel releases a lock at any end of a process."""
    directory = Path(tempfile.gettempdir(), "kr270_milling_domains")
    directory.mkdir(exist_ok=True)
    return directory


@contextlib.contextmanager
def own_turn(kind: str):
    """One test of each kind at a time in a run: no two graphs of five processes run together."""
    with open(_locks() / f"{kind}_{os.environ.get('PYTEST_XDIST_TESTRUNUID', os.getpid())}", "w") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        yield


@contextlib.contextmanager
def own_domain():
    """A ROS domain id that no other test has."""
    directory = _locks()
    for _ in range(COUNT):
        number = 1 + next(_turn) % COUNT
        with open(directory / str(number), "w") as stream:
            try:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                continue
            if not is_used(number):
                yield number
                return
    pytest.fail("every ROS domain id is in use")


def is_used(domain: int) -> bool:
    """Whether a UDP port of the domain is open."""
    first, each = PORTS
    return any(first + each * domain <= port < first + each * (domain + 1) for port in open_ports())


def open_ports() -> set[int]:
    """UDP ports of this host."""
    tables = [path for path in (Path("/proc/net/udp"), Path("/proc/net/udp6")) if path.exists()]
    return {int(row.split()[1].rpartition(":")[2], 16) for t in tables for row in t.read_text().splitlines()[1:]}


@contextlib.contextmanager
def running(command: list[str], environment: dict[str, str], **kwargs):
    """A process that ends with the block, also where a check in the block fails while the process runs."""
    with subprocess.Popen(command, env=environment, **kwargs) as process:
        try:
            yield process
        finally:
            process.kill()


def from_msg(msg):
    """The record that a message object carries; of a MultiDOFJointTrajectory a Trajectory."""
    from rclpy.serialization import serialize_message

    package = type(msg).__module__.partition(".msg")[0]
    return from_bytes(f"{package}/msg/{type(msg).__name__}", serialize_message(msg))
