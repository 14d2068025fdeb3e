"""Node processes: command line and parameter file, start in a separate session, and stop."""

from __future__ import annotations

import contextlib
import errno
import math
import os
import shlex
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

from kr270_milling.base.arguments import STOPS
from kr270_milling.base.errors import MillingError
from kr270_milling.live.ros.environment import child_environment
from kr270_milling.recordings.messages.topics import ROBOT


class RunError(MillingError):
    """The run cannot continue; node: the failed node; reason: what happened."""

    def __init__(self, node: str, reason: str):
        self.node, self.reason = node, reason
        super().__init__(f"{node}: {reason}")


class AlreadyRunning(MillingError):
    """Another graph has the same node names; node is one of them."""

    def __init__(self, node: str):
        self.node = node
        super().__init__(
            f"a node {node} already runs in this ROS domain: stop that graph first, or choose another --namespace or "
            "ROS_DOMAIN_ID"
        )


def own_graph(domain: int, namespace: str) -> socket.socket:
    """Return the right to start the nodes of a namespace in a ROS domain, until it is closed. Raises AlreadyRunning.

    If two runs start at once, the first has it. The name of a socket is free again when its process ends, and it
    belongs to the network of this host, as the loopback interface does.
    """
    own = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        own.bind(f"\0kr270_milling/{domain}{namespace}")
    except OSError as error:  # another one: this system has no such names
        if error.errno == errno.EADDRINUSE:
            own.close()
            raise AlreadyRunning(f"{namespace.rstrip('/')}/{ROBOT}") from None
    return own


class Child:
    """A process with one node or several; its output goes to a log below ``logs``."""

    def __init__(self, nodes: Sequence[str], arguments: Iterable[str], logs: Path):
        self.name = "+".join(nodes)
        self.log = logs / f"{self.name}.log"
        program = nodes if len(nodes) == 1 else ("milling_cell", *nodes)
        command = [sys.executable, "-m", "kr270_milling.live.nodes", *program, *arguments]
        before = signal.pthread_sigmask(signal.SIG_BLOCK, STOPS)  # until the child has its handlers, see nodes.start
        try:
            with open(self.log, "ab") as stream:
                self.process = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=stream,
                    stderr=subprocess.STDOUT,
                    cwd=logs,
                    env=child_environment(),
                    start_new_session=True,
                )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self.ended_at = math.inf  #: [s of the monotonic clock]
        threading.Thread(target=self._wait, daemon=True).start()

    def _wait(self) -> None:
        """Note the end at once: a runner under load looks at its processes late, and two may have ended by then."""
        self.process.wait()
        self.ended_at = time.monotonic()

    @property
    def pid(self) -> int:
        return self.process.pid

    @property
    def alive(self) -> bool:
        return self.ended_at == math.inf

    def why_ended(self) -> str:
        """Return why the process ended, in one sentence."""
        code = self.process.returncode
        if code < 0:
            return f"was ended by {signal.Signals(-code).name}"
        return f"ended with exit code {code} ({self.last_line() or 'it printed nothing'}; see {self.log})"

    def last_line(self) -> str:
        """Return the last line of the log that is not empty."""
        with open(self.log, "rb") as stream:
            stream.seek(max(0, os.fstat(stream.fileno()).st_size - 4096))
            lines = stream.read().decode("utf-8", "replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "")

    def signal(self, number: int) -> None:
        if self.alive:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.pid, number)


def stop(children: Iterable[Child], grace: float = 3.0) -> list[str]:
    """Interrupt all nodes at once and wait; kill those that do not end within ``grace`` [s] and return their names."""
    children = [c for c in children if c.alive]
    for child in children:
        child.signal(signal.SIGINT)
        child.signal(signal.SIGCONT)  # a stopped process handles no signal
    end = time.monotonic() + grace
    while any(child.alive for child in children) and time.monotonic() < end:
        time.sleep(0.01)
    killed = [child for child in children if child.alive]
    for child in killed:
        child.signal(signal.SIGKILL)
        child.process.wait()
    return [child.name for child in killed]


def recording_parameters(out: Path, name: str, files: Iterable[Path], plant: str = "") -> dict:
    """Return the recorder's parameters for the pass ``name``; the directory, which starts the recording, comes last.

    files: further ones to attach; plant: parameter file of the cell that robot and cut run, where it differs from the
    planned one.
    """
    attach = [str(out / "cell.yaml")]
    if plant:
        (out / "log" / name).mkdir(exist_ok=True)
        attach.append(str(out / "log" / name / "plant.yaml"))
        Path(attach[-1]).write_text(plant, encoding="utf-8")
    attach += map(str, files)
    return {"attach": attach, "command": shlex.join(sys.argv), "directory": str(out / name)}
