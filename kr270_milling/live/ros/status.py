"""The status of a node for programs: one latched topic a node."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from typing import Any

from kr270_milling.base.errors import MessageError
from kr270_milling.live.ros import topics

__all__ = ["Status", "status_topic"]


@dataclass(frozen=True)
class Status:
    """The status that a node publishes as JSON on ``~/status`` five times a second and at every change."""

    pid: int
    level: int  #: as in diagnostic_msgs/DiagnosticStatus
    message: str
    error: str = ""  #: last message of the level ERROR: a status may replace the one before on its way
    listeners: dict[str, int] = field(default_factory=dict)  #: matched subscribers of each topic that it publishes
    sources: dict[str, int] = field(default_factory=dict)  #: matched publishers of each topic that it subscribes to
    stamps_ns: dict[str, int] = field(default_factory=dict)  #: last stamp of topics that it publishes, reads or records
    values: dict[str, Any] = field(default_factory=dict)

    def to_msg(self):
        """Return the status as a message."""
        return topics.STATUS.type(data=json.dumps(asdict(self)))

    @classmethod
    def from_text(cls, text: str) -> Status:
        """Return the status of a message. Raises MessageError where the text is no status."""
        try:
            status = cls(**json.loads(text))
            tables = (status.listeners, status.sources, status.stamps_ns)
            numbers = (status.pid, status.level, *(number for table in tables for number in dict(table).values()))
            texts = (status.message, status.error)
            whole = all(isinstance(number, int) for number in numbers) and all(isinstance(text, str) for text in texts)
            if not (whole and isinstance(status.values, dict)):
                raise TypeError
        except (ValueError, TypeError, RecursionError):
            raise MessageError(f"status: {text[:60]!r} is not the status of a node") from None
        return status


def status_topic(name: str) -> topics.RosTopic:
    """Return the topic of the status of the node ``name``, relative to the namespace of the subscriber."""
    return topics.STATUS._replace(name=topics.STATUS.name.replace("~", name))
