"""Node processes: started in a session of their own, told to end, and ended if they do not."""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

from kr270_milling.base.errors import MillingError
from kr270_milling.ros.environment import child_environment

__all__ = ["Child", "RunError", "remove_litter", "stop"]

GRACE = 3.0  # [s] that a node has to end by itself
SHARED = "/dev/shm/"
LOCKS = ("_el", "_sl")  # behind the name of a port or segment: locked by its one listener or owner, or by several
MAKING = 0.2  # [s] of the wall in which whoever makes a port has locked it as well


class RunError(MillingError):
    """The graph cannot go on; node names the culprit, reason tells what happened."""

    def __init__(self, node: str, reason: str):
        self.node, self.reason = node, reason
        super().__init__(f"{node}: {reason}")


class Child:
    """One node as a process; what it prints goes to ``log``."""

    def __init__(self, name: str, arguments: Iterable[str], log: Path):
        self.name, self.log = name, log
        self.shared: set[str] = set()  #: files under /dev/shm that it has used
        command = [sys.executable, "-m", "kr270_milling.nodes", name, *arguments]
        with open(log, "ab") as stream:
            self.process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=stream, stderr=subprocess.STDOUT, cwd=log.parent,
                env=child_environment(), start_new_session=True,
            )  # fmt: skip

    @property
    def pid(self) -> int:
        return self.process.pid

    @property
    def alive(self) -> bool:
        return self.process.poll() is None

    def why_ended(self) -> str:
        """One sentence about a process that is no longer there."""
        code = self.process.returncode
        if code < 0:
            return f"was ended by {signal.Signals(-code).name}"
        return f"ended with exit code {code} ({self.last_words() or 'it printed nothing'}; see {self.log})"

    def last_words(self) -> str:
        with open(self.log, "rb") as stream:
            stream.seek(max(0, os.fstat(stream.fileno()).st_size - 4096))
            lines = stream.read().decode("utf-8", "replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "")

    def signal(self, number: int) -> None:
        if self.alive:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.pid, number)

    def note_shared(self) -> None:
        self.shared |= _shared_files(self.pid)


def stop(children: Iterable[Child], grace: float = GRACE) -> list[str]:
    """End node after node, all at once, and wait for them; returns the names of those that had to be killed."""
    children = [c for c in children if c.alive]
    for child in children:
        child.note_shared()
        child.signal(signal.SIGINT)
        child.signal(signal.SIGCONT)  # a stopped process hears no signal
    end = time.monotonic() + grace
    while any(child.alive for child in children) and time.monotonic() < end:
        time.sleep(0.01)
    killed = [child for child in children if child.alive]
    for child in killed:
        child.signal(signal.SIGKILL)
        child.process.wait()
    return [child.name for child in killed]


def _shared_files(pid: int | str) -> set[str]:
    """Files of Fast DDS under /dev/shm that a process has mapped or open."""
    found: set[str] = set()
    with contextlib.suppress(OSError):  # it has ended, or belongs to somebody else
        with open(f"/proc/{pid}/maps", encoding="utf-8", errors="replace") as stream:
            found.update(line.split(maxsplit=5)[5].strip() for line in stream if SHARED in line)
        for entry in os.listdir(f"/proc/{pid}/fd"):
            found.add(os.readlink(f"/proc/{pid}/fd/{entry}"))
    return {name for name in found if name.startswith((SHARED + "fastrtps_", SHARED + "sem.fastrtps_"))}


def _whole(file: str) -> str:
    """The port or segment that a file under /dev/shm belongs to, as which its locks and its mutex count too."""
    name = file.removeprefix(SHARED).removeprefix("sem.").partition("_mutex")[0]
    return SHARED + name.removesuffix("_el").removesuffix("_sl")


def _ports_of_domain() -> set[str]:
    """Files of the ports of our ROS domain under /dev/shm (7400 and 250 a domain: RTPS, section 9.6.1)."""
    text = os.environ.get("ROS_DOMAIN_ID", "")
    first = 7400 + 250 * (int(text) if text.isdecimal() else 0)
    ports = {f"{SHARED}fastrtps_port{number}" for number in range(first, first + 250)}
    found = os.listdir(SHARED) if os.path.isdir(SHARED) else []
    return {SHARED + name for name in found if _whole(SHARED + name) in ports}


@contextlib.contextmanager
def _claimed(whole: str) -> Iterator[bool]:
    """Whether nobody listens at a port or owns a segment any more, and that it stays so in the block.

    Fast DDS holds a lock on a file beside it (flock) for as long as its maker lives; unlike /proc this also tells of
    processes in other containers that share /dev/shm. One that has no such file yet may just be in the making.
    """
    with contextlib.ExitStack() as stack:
        yield _lock(whole, stack)


def _lock(whole: str, stack: contextlib.ExitStack) -> bool:
    locks = _locks(whole)
    if not locks and os.path.exists(whole):
        time.sleep(MAKING)
        locks = _locks(whole)
    ours = _shared_files(os.getpid())  # a middleware that is stuck in this process keeps its own
    return all(name in ours or _try_lock(name, stack) for name in locks)


def _locks(whole: str) -> list[str]:
    return [whole + kind for kind in LOCKS if os.path.exists(whole + kind)]


def _try_lock(name: str, stack: contextlib.ExitStack) -> bool:
    try:
        file = os.open(name, os.O_RDONLY | os.O_NOFOLLOW)
        stack.callback(os.close, file)
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # locked, or of another user
        return False
    return True


def remove_litter(children: Iterable[Child]) -> list[str]:
    """Remove what killed nodes left in /dev/shm and no other process uses; returns the files.

    This process does not count: Fast DDS keeps the segment of a partner mapped when all is closed. It counts for
    the other ports of our ROS domain, which a node may have made anew after it was looked at.
    """
    left = {name for child in children for name in child.shared if os.path.exists(name)}
    left |= _ports_of_domain() - _shared_files(os.getpid())
    if not left:
        return []
    for pid in filter(str.isdigit, os.listdir("/proc")):
        if int(pid) != os.getpid():
            left -= _shared_files(pid)
    removed = []
    for whole, files in itertools.groupby(sorted(left, key=_whole), _whole):
        with contextlib.suppress(OSError), _claimed(whole) as free:
            for name in files if free else ():
                os.unlink(name)
                removed.append(name)
    return sorted(removed)
