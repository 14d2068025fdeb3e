"""A ROS domain id that no other test run on this machine uses."""

from __future__ import annotations

import contextlib
import fcntl
import os
import subprocess
import tempfile
from pathlib import Path

import pytest

#: what a shell may have set about discovery
DISCOVERY = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "ROS_AUTOMATIC_DISCOVERY_RANGE")
ROOT = Path(__file__).resolve().parents[1]


@contextlib.contextmanager
def own_domain():
    """Locked by a file, so that the kernel gives it back whatever becomes of this process."""
    directory = Path(tempfile.gettempdir(), "kr270_milling_domains")
    directory.mkdir(exist_ok=True)
    for offset in range(100):
        number = 1 + (os.getpid() + offset) % 100
        with open(directory / str(number), "w") as stream:
            try:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                continue
            yield number
            return
    pytest.fail("every ROS domain id is in use by another test run")


def environment_of_processes(domain: int, **more: str) -> dict[str, str]:
    """For processes that a test starts: this checkout, that domain, the discovery that is shipped."""
    kept = {name: value for name, value in os.environ.items() if name not in DISCOVERY}
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    return {**kept, "ROS_DOMAIN_ID": str(domain), "PYTHONPATH": path, **more}


@contextlib.contextmanager
def running(command: list[str], environment: dict[str, str], **kwargs):
    """A process that ends with the block, also where a check in the block fails while the process goes on."""
    with subprocess.Popen(command, env=environment, **kwargs) as process:
        try:
            yield process
        finally:
            process.kill()
