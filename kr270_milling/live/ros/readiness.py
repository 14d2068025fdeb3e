"""Readiness for a pass: the compensator decides from the statuses of the nodes."""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping, Sequence
from functools import partial

from kr270_milling.base.errors import MessageError
from kr270_milling.base.samples import Text
from kr270_milling.live.ros.status import Status, status_topic
from kr270_milling.recordings.messages.topics import COMPENSATOR, CUT, RECORDER, ROBOT

__all__ = ["WAIT_FOR", "Readiness", "is_recorded", "unmatched"]

WAIT_FOR = f"{CUT}, {ROBOT}?, {RECORDER}?"  #: names, separated by commas; with ?: only where the node is in the graph


class Readiness:
    """Conditions before a pass; node: decides and calls ``check``; names: as ``WAIT_FOR``.

    A node without a status counts when it publishes one of ``inputs``, topics with their full names.
    """

    def __init__(self, node, names: str, inputs: Sequence[str]):
        words = [name.strip() for name in names.split(",") if name.strip()]
        self.waiting_for = f"{node.get_name()} is starting"  #: in a few words; empty when a pass may start
        self._node = node
        self._inputs = inputs
        self._needed = [name for name in words if not name.endswith("?")]
        self._statuses: dict[str, Status] = {}
        self._confirmed: set[str] = set()  # nodes with a status since all nodes were matched
        names_alone = [word.rstrip("?") for word in words]
        self._topics = {name: node.subscribe(status_topic(name), partial(self._take, name)) for name in names_alone}

    def _take(self, name: str, text: Text) -> None:
        self._statuses[name] = Status.from_text(text.text)
        self._confirmed.add(name)

    def check(self) -> None:
        """Decide again, and publish the answer in the status of the node where it has changed."""
        before, self.waiting_for = self.waiting_for, self._missing()
        if self.waiting_for != before:
            self._node.set_values(waiting_for=self.waiting_for)
            self._node.publish_report()

    def _missing(self) -> str:
        present = {name for name, topic in self._topics.items() if topic.get_publisher_count()}
        self._statuses = {name: status for name, status in self._statuses.items() if name in present}
        for name in self._needed:
            if name not in present and not self._is_foreign_partner(name):
                return f"{name} is not in the graph (parameter wait_for)"
        if problem := self._node.used("~/status", self._unmatched):
            self._confirmed.clear()
            return problem
        return next((f"no status of {name} yet" for name in sorted(present - self._confirmed)), "")

    def _unmatched(self) -> str:
        try:
            return unmatched({**self._statuses, self._node.get_name(): self._node.status()})
        except Exception as error:  # noqa: BLE001 - a stranger may send any values in a status
            self._statuses.clear()
            self._confirmed.clear()
            raise MessageError(f"status: its values cannot be used: {error}") from None

    def _is_foreign_partner(self, name: str) -> bool:
        infos = (info for topic in self._inputs for info in self._node.get_publishers_info_by_topic(topic))
        return any(info.node_name == name.rpartition("/")[2] for info in infos)


def is_recorded(topic: str, patterns: Sequence[str]) -> bool:
    """Return whether a recorder with these patterns (none: every topic) records a topic."""
    if topic in patterns or topic.endswith(tuple(f"/{node}/status" for node in (ROBOT, CUT, COMPENSATOR, RECORDER))):
        return topic in patterns
    if not patterns:
        return topic not in ("/rosout", "/parameter_events")
    return any(fnmatch.fnmatchcase(topic, p) for p in patterns)


def unmatched(statuses: Mapping[str, Status]) -> str:
    """Return what the nodes of a pass lack, in a few words; empty when the pass may start.

    Every subscriber and every publisher of a topic have discovered each other, a recorder has all topics, and all nodes
    have the same reference. statuses: by node.
    """
    for publisher, status in statuses.items():
        for topic, count in status.listeners.items():
            wanted = [node for node in statuses if node != publisher and _reads(statuses[node], topic)]
            for node in wanted:
                if not statuses[node].sources.get(topic):
                    return f"{node} has not discovered a publisher of {topic}"
            if count < len(wanted):
                return f"{publisher} has not discovered every subscriber of {topic}"
    for key in ("reference", "recording"):
        values = {node: str(status.values[key]) for node, status in statuses.items() if key in status.values}
        if len(set(values.values())) > 1:
            owners = "; ".join(f"{node} has {value or 'none'}" for node, value in values.items())
            return f"not every node has the {key}: {owners}"
    return ""


def _reads(status: Status, topic: str) -> bool:
    """Return whether a node subscribes to a topic; ``records`` are the patterns of a recorder with an open file."""
    patterns, left_out = status.values.get("records"), status.values.get("left_out", ())
    return topic in status.sources or (patterns is not None and topic not in left_out and is_recorded(topic, patterns))
