"""Check that a pass may start (matched topics) and may continue (processes, errors, restarts, silence)."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping

from kr270_milling.base.errors import MillingError, one_line
from kr270_milling.live.graph.driver import Driver, compatible
from kr270_milling.live.graph.processes import Child, RunError
from kr270_milling.live.ros.node import LOST
from kr270_milling.recordings.messages.topics import COMPENSATOR, CUT, RECORDER, ROBOT, TOPICS

__all__ = [
    "COMPENSATOR", "CUT", "LOST", "QUIET", "RECORDER", "ROBOT", "AlreadyRunning", "Hooks", "Watchdog", "unmatched",
]  # fmt: skip

QUIET = 1.0  # [s] without a report, after which the run prints a warning
HELD_UP = 0.5  # [s] between two checks; after a longer time this process first takes the reports that wait


class Hooks:
    """The hooks of a run on the command line; a subclass overrides what it needs."""

    def before_check(self) -> None:
        """Called some 50 times a second while the run waits, before the graph checks its processes."""

    def pass_recorded(self) -> None:
        """Called at the end of a pass, before the recording is closed."""

    def warn(self, sentence: str) -> None:
        """Print a warning while the run continues."""
        print(f"kr270_milling: {one_line(sentence)}", file=sys.stderr)


class AlreadyRunning(MillingError):
    """Another graph has the same node names; node is one of them."""

    def __init__(self, node: str):
        self.node = node
        super().__init__(
            f"a node {node} already runs in this ROS domain: stop that graph first, or choose another --namespace or "
            "ROS_DOMAIN_ID"
        )


class Watchdog:
    """Check the nodes while the run waits; ``warn`` takes the warnings."""

    def __init__(self, excused: set[str], warn: Callable[[str], None]):
        self.excused = excused  #: nodes that may be silent now
        self.coming_up = True  #: another graph with these names is an error now; later its reports are ignored
        self.process_ids: dict[str, str] = {}  #: process id of each node at the start of the pass
        self._warn = warn
        self._checked = time.monotonic()
        self._take_reports_until = 0.0
        self._quiet: set[str] = set()

    def check(self, driver: Driver, children: Mapping[str, Child]) -> None:
        """Raise AlreadyRunning or RunError when the run cannot continue."""
        ours = {driver.name_of(name): name for name in children}
        others = sorted(driver.foreign & set(ours))
        if self.coming_up and others:
            raise AlreadyRunning(others[0])
        for name, child in children.items():
            if not child.alive:
                raise RunError(name, child.why_ended())
        for name, message in driver.errors:
            if name in ours:
                raise RunError(ours[name], message)
        for name, pid in self.process_ids.items():
            if driver.value(name, "pid") not in ("", pid):
                raise RunError(name, "was restarted in mid-pass")
        self.check_silence(driver, set(children), time.monotonic())

    def check_silence(self, driver: Driver, nodes: set[str], now: float) -> None:
        """Warn about a silent node, then raise RunError; now: [s] of the monotonic clock."""
        if now - self._checked > HELD_UP:  # this process itself was stopped
            self._take_reports_until = now + HELD_UP
        self._checked = now
        if now < self._take_reports_until:
            return
        silences = {name: driver.silence(name, now) for name in nodes - self.excused}
        if len(silences) > 1 and max(silences.values()) > LOST and min(silences.values()) > LOST / 2:
            raise RunError(
                "graph", f"no node has reported for {LOST / 2:g} s: the middleware of this process may be blocked"
            )
        for name, silent in silences.items():
            if silent > LOST:
                raise RunError(name, f"has not reported for {LOST:g} s")
            if silent > QUIET and name not in self._quiet:
                self._warn(f"{name}: has not reported for {QUIET:g} s; waiting")
            (self._quiet.add if silent > QUIET else self._quiet.discard)(name)


def unmatched(driver: Driver, recorded: bool) -> str:
    """Return what is not matched yet, in a few words; empty when a pass may start.

    recorded: the recorder must be matched; otherwise it must be unmatched, before the next recording begins.
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
        return f"{topic} has no subscriber in {', '.join(sorted(wanted - set(there)))}"
    if not recorded and RECORDER in there:
        return f"the recorder of the previous pass still subscribes to {topic}"
    expected = sum(compatible(ours, s) for s in subscriptions)
    if driver.counts(publisher, "listeners").get(topic, -1) != expected:
        return f"{publisher} has not discovered every subscriber of {topic}"
    for node in wanted:
        if driver.counts(node, "sources").get(topic, -1) != sum(compatible(p, there[node]) for p in publishers):
            return f"{node} has not discovered every publisher of {topic}"
    return ""


def _of_graph(driver: Driver, ends) -> dict[str, object]:
    """Return the ends that belong to nodes of this namespace, by node."""
    return {end.node_name: end for end in ends if end.node_namespace == driver.namespace}
