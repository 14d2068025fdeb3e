"""What Fast DDS leaves in shared memory when a process is killed."""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import os
import time
from collections.abc import Iterable, Iterator

__all__ = ["remove_litter", "shared_files"]

SHARED = "/dev/shm/"
LOCKS = ("_el", "_sl")  # behind the name of a port or segment: locked by its one listener or owner, or by several
MAKING = 0.2  # [s] of the wall in which whoever makes a port has locked it as well


def shared_files(pid: int | str) -> set[str]:
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
    ours = shared_files(os.getpid())  # a middleware that is stuck in this process keeps its own
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


def remove_litter(children: Iterable) -> list[str]:
    """Remove what killed nodes (each with the files ``shared``) left in /dev/shm and no other process uses; returns it.

    This process does not count: Fast DDS keeps the segment of a partner mapped when all is closed. It counts for
    the other ports of our ROS domain, which a node may have made anew after it was looked at.
    """
    left = {name for child in children for name in child.shared if os.path.exists(name)}
    left |= _ports_of_domain() - shared_files(os.getpid())
    if not left:
        return []
    for pid in filter(str.isdigit, os.listdir("/proc")):
        if int(pid) != os.getpid():
            left -= shared_files(pid)
    removed = []
    for whole, files in itertools.groupby(sorted(left, key=_whole), _whole):
        with contextlib.suppress(OSError), _claimed(whole) as free:
            for name in files if free else ():
                os.unlink(name)
                removed.append(name)
    return sorted(removed)
