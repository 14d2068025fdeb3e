"""Whether a pass may start, who hears whom; whether it can go on: processes that ended, errors, restarts, silence."""

from __future__ import annotations

import errno
import hashlib
import socket
import sys
import time
from collections.abc import Callable, Mapping

from kr270_milling.base.errors import MillingError, one_line
from kr270_milling.graph.driver import Driver, compatible
from kr270_milling.graph.processes import Child, RunError
from kr270_milling.messages.topics import COMPENSATOR, CUT, RECORDER, ROBOT, TOPICS
from kr270_milling.ros.node import LOST

__all__ = [
    "COMPENSATOR", "CUT", "LOST", "QUIET", "RECORDER", "ROBOT", "AlreadyRunning", "Hooks", "Watchdog", "claim",
    "unmatched",
]  # fmt: skip

QUIET = 1.0  # [s] without a report after which this is told
HELD_UP = 0.5  # [s] between two looks of this process, after which the reports that wait are heard first


class Hooks:
    """The hooks of a run on the command line; a subclass overrides what it needs."""

    def looked(self) -> None:
        """Called some 50 times a second while something is waited for, before the graph looks at its processes."""

    def pass_recorded(self) -> None:
        """Called at the end of a pass, while its recorder is still there."""

    def tell(self, sentence: str) -> None:
        """What the user should know while the run goes on."""
        print(f"kr270_milling: {one_line(sentence)}", file=sys.stderr)

    def leaving(self, error: BaseException | None) -> None:
        """Called before the graph is left, where the middleware may end this process and nothing be told any more."""
        if isinstance(error, MillingError):
            self.tell(str(error))
            error.told = True


class AlreadyRunning(MillingError):
    """Another graph has the same node names; node is one of them."""

    def __init__(self, node: str):
        self.node = node
        super().__init__(
            f"a node {node} already runs in this ROS domain: stop that graph first, or choose another --namespace or "
            "ROS_DOMAIN_ID"
        )


def claim(domain: int, namespace: str) -> socket.socket:
    """The node names of a graph, for one run on this host, until the socket is closed or its process ends.

    Two runs that come up together have not heard of each other yet, and what the nodes of the second publish at once
    would reach the first in mid-pass. So their names are also a name in the abstract space of Unix sockets, which the
    kernel gives away once; where there is none, only the reports of the nodes tell. Raises AlreadyRunning.
    """
    held = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    name = hashlib.sha256(f"{domain} {namespace}".encode()).hexdigest()
    try:
        held.bind(f"\0kr270_milling_{name}")
    except OSError as error:
        held.close()
        if error.errno == errno.EADDRINUSE:
            raise AlreadyRunning(f"{namespace.rstrip('/')}/{ROBOT}") from None
    return held


class Watchdog:
    """Looks at the nodes while something is waited for; ``tell`` takes what the user should know meanwhile."""

    def __init__(self, excused: set[str], tell: Callable[[str], None]):
        self.excused = excused  #: nodes that may be silent now
        self.coming_up = True  #: another graph with these names is an error; later on its reports are ignored
        self.of_pass: dict[str, str] = {}  #: process id of each node when the pass began
        self._tell = tell
        self._looked = time.monotonic()
        self._hear_until = 0.0
        self._quiet: set[str] = set()

    def look(self, driver: Driver, children: Mapping[str, Child]) -> None:
        """Raises AlreadyRunning or RunError when the graph cannot go on."""
        ours = {driver.name_of(name): name for name in children}
        strangers = sorted(driver.foreign & set(ours))
        if self.coming_up and strangers:
            raise AlreadyRunning(strangers[0])
        for name, child in children.items():
            if not child.alive:
                raise RunError(name, child.why_ended())
        for name, message in driver.errors:
            if name in ours:
                raise RunError(ours[name], message)
        for name, pid in self.of_pass.items():
            if driver.says(name, "pid") not in ("", pid):
                raise RunError(name, "was restarted in mid-pass")
        self.look_for_silence(driver, set(children), time.monotonic())

    def look_for_silence(self, driver: Driver, nodes: set[str], now: float) -> None:
        """now: [s] of the monotonic clock."""
        if now - self._looked > HELD_UP:  # it was us who did not listen
            self._hear_until = now + HELD_UP
        self._looked = now
        if now < self._hear_until:
            return
        silences = {name: driver.silence(name, now) for name in nodes - self.excused}
        if len(silences) > 1 and max(silences.values()) > LOST and min(silences.values()) > LOST / 2:
            driver.stuck = True
            what = f"no node has been heard of for {LOST / 2:g} s: the middleware of this process may be blocked"
            raise RunError("graph", what)
        for name, silent in silences.items():
            if silent > LOST:
                raise RunError(name, f"has not been heard of for {LOST:g} s")
            if silent > QUIET and name not in self._quiet:
                self._tell(f"{name}: has not been heard of for {QUIET:g} s; waiting")
            (self._quiet.add if silent > QUIET else self._quiet.discard)(name)


def unmatched(driver: Driver, recorded: bool) -> str:
    """What is not matched yet, in a few words; empty when a pass may start.

    recorded: whether the recorder must be there; if not, it must be gone, so that the next one is not mistaken for it.
    """
    for topic in TOPICS:
        wanted = {*topic.subscribers, RECORDER} - {topic.publisher} if recorded else set(topic.subscribers)
        if topic.needed and (
            problem := _unmatched(driver, driver.name_of(topic.name), topic.publisher, wanted, recorded)
        ):
            return problem
    return ""


def _unmatched(driver: Driver, topic: str, publisher: str, wanted: set[str], recorded: bool) -> str:
    publishers, subscriptions = driver.ends(topic)
    ours = _of_graph(driver, publishers).get(publisher)
    there = _of_graph(driver, subscriptions)
    if ours is None:
        return f"{publisher} does not publish {topic}"
    if wanted - set(there):
        return f"{topic} is not heard by {', '.join(sorted(wanted - set(there)))}"
    if not recorded and RECORDER in there:
        return f"the last recorder still listens to {topic}"
    expected = sum(compatible(ours, s) for s in subscriptions)
    if driver.counts(publisher, "listeners").get(topic, -1) != expected:
        return f"{publisher} has not found every listener of {topic}"
    for node in wanted:
        if driver.counts(node, "heard").get(topic, -1) != sum(compatible(p, there[node]) for p in publishers):
            return f"{node} has not found every publisher of {topic}"
    return ""


def _of_graph(driver: Driver, ends) -> dict[str, object]:
    """The ends that belong to nodes of this namespace, by node."""
    return {end.node_name: end for end in ends if end.node_namespace == driver.namespace}
