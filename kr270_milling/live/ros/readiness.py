"""Readiness for a pass: the compensator decides from the reports of the nodes in /diagnostics."""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from kr270_milling.live.ros import topics
from kr270_milling.recordings.messages.definitions import deserialise
from kr270_milling.recordings.messages.topics import CUT, RECORDER, ROBOT

WAIT_FOR = f"{CUT}, {ROBOT}?, {RECORDER}?"  #: names, separated by commas; with ?: only where the node is in the graph
SUBSCRIBERS = "subscribers of "  #: begin of a key; then a topic that the node publishes


class Report(NamedTuple):
    """The report of a node of this package in /diagnostics."""

    level: int  #: as in diagnostic_msgs/DiagnosticStatus
    message: str
    values: dict[str, str]


def read_reports(data: bytes) -> dict[str, Report]:
    """Return the reports of a DiagnosticArray by the full names of the nodes. Raises ValueError."""
    statuses = deserialise("diagnostic_msgs/msg/DiagnosticArray", data).status
    return {s.name: Report(s.level, s.message, {pair.key: pair.value for pair in s.values}) for s in statuses}


def joined(names) -> str:
    """Return names as the text of a value."""
    return ", ".join(sorted(names))


def _names(text: str) -> list[str]:
    return text.split(", ") if text else []


class Readiness:
    """Conditions before a pass; node: decides and calls ``check``; names: as ``WAIT_FOR``.

    A node without reports counts when it publishes one of ``inputs``, topics with their full names. A lifecycle node
    counts when it is active; with ? also before.
    """

    def __init__(self, node, names: str, inputs: Sequence[str]):
        words = [name.strip() for name in names.split(",") if name.strip()]
        self.waiting_for = f"{node.get_name()} is starting"  #: in a few words; empty when a pass may start
        self._node = node
        self._inputs = inputs
        self._needed = {node.full_name(name): name for name in words if not name.endswith("?")}
        self._names = {node.full_name(name.rstrip("?")): name.rstrip("?") for name in words}
        self._reports: dict[str, Report] = {}  # by full names
        self._confirmed: set[str] = set()  # nodes with a report since all nodes were matched
        node.subscribe(topics.DIAGNOSTICS, self._take, read_reports)

    def _take(self, reports: Mapping[str, Report]) -> None:
        known = {name: report for name, report in reports.items() if name in self._names}
        self._reports |= known
        self._confirmed |= known.keys()

    def check(self) -> None:
        """Decide again, and publish the answer in the report of the node where it has changed."""
        before, self.waiting_for = self.waiting_for, self._missing()[:300]  # a stranger may send long values
        if self.waiting_for != before:
            self._node.set_values(waiting_for=self.waiting_for)
            self._node.publish_report()

    def _missing(self) -> str:
        reporting = self._publishers(topics.DIAGNOSTICS.name)
        partners = {name.rpartition("/")[2] for topic in self._inputs for name in self._publishers(topic)}
        for full, name in self._needed.items():
            if full not in reporting and name.rpartition("/")[2] not in partners:
                return f"{name} is not in the graph (parameter wait_for)"
        # a driver of another maker may publish on /diagnostics, but no report of its node
        own = (ROBOT, CUT, RECORDER)
        ours = {full for full in reporting & self._names.keys() if full in self._reports or self._names[full] in own}
        self._reports = {full: report for full, report in self._reports.items() if full in ours}
        for full, name in self._needed.items():
            if full in self._reports and self._reports[full].values.get("state", "") not in ("", "active"):
                return f"{name} is not active"
        if problem := unmatched({**self._reports, self._node.get_fully_qualified_name(): self._node.own_report()}):
            self._confirmed.clear()
            return problem
        return next((f"no report of {name} yet" for name in sorted(ours - self._confirmed)), "")

    def _publishers(self, topic: str) -> set[str]:
        """Return the full names of the nodes that publish on a topic."""
        infos = self._node.get_publishers_info_by_topic(topic)
        return {f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in infos}


def is_recorded(topic: str, patterns: Sequence[str]) -> bool:
    """Return whether a recorder with these patterns (none: every topic) records a topic.

    A pattern that is longer than a name of a topic can be matches none: a stranger's of 100,000 brackets takes minutes.
    """
    if not patterns:
        return topic not in ("/rosout", "/parameter_events")
    longest = 255  # characters, of a name in rmw
    return any(len(p) <= longest and fnmatch.fnmatchcase(topic, p) for p in patterns)


def unmatched(reports: Mapping[str, Report]) -> str:
    """Return what the nodes of a pass lack, in a few words; empty when the pass may start.

    Every publisher has discovered every subscriber, a recorder with an open file has all topics, and all nodes have the
    same reference. The publisher counts: its history keeps what it publishes from then on until a subscriber has it.
    """
    for publisher, report in reports.items():
        for key, text in report.values.items():
            topic = key.removeprefix(SUBSCRIBERS) if key.startswith(SUBSCRIBERS) else ""
            for node in sorted(reports.keys() - {publisher, *_names(text)}):
                if topic and _reads(reports[node], topic):
                    return f"{publisher} has not discovered that {node} subscribes to {topic}"
    for key in ("reference", "recording"):
        values = {node: report.values[key] for node, report in reports.items() if key in report.values}
        if len(set(values.values())) > 1:
            owners = "; ".join(f"{node} has {value or 'none'}" for node, value in values.items())
            return f"not every node has the {key}: {owners}"
    return ""


def _reads(report: Report, topic: str) -> bool:
    """Return whether a node subscribes to a topic; ``records`` are the patterns of a recorder with an open file."""
    values = report.values
    if topic in _names(values.get("reads", "")):
        return True
    left_out = _names(values.get("left_out", ""))
    return "records" in values and topic not in left_out and is_recorded(topic, _names(values["records"]))
