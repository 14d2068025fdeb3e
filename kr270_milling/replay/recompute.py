"""A recording recomputed: its inputs once more through the nodes' protocols, its outputs compared bit for bit.

No ROS graph and no clock: the messages come in the order of the file. Several robots in their namespaces are recomputed
side by side, with the cell of the recording.
"""

from __future__ import annotations

from dataclasses import dataclass

from kr270_milling import __version__
from kr270_milling.bag.reader import Recording
from kr270_milling.bag.verify import findings
from kr270_milling.replay.compare import Channel, Difference
from kr270_milling.replay.complete import incomplete
from kr270_milling.replay.robots import Robots, Stop

__all__ = ["Recomputed", "recompute"]


@dataclass(frozen=True)
class Recomputed:
    """The verdict: "identical", "different", "damaged" where all that was compared is the same, but a checksum or an
    index of the file does not fit, or "incomplete" where a model could not go on, or where not all was compared that
    should have been."""

    file: str
    cut_off: bool
    channels: dict[str, Channel]
    first: Difference | None
    stops: tuple[Stop, ...]
    version: str  #: of the package that wrote the recording
    damage: tuple[str, ...] = ()  #: what does not fit in the file

    @property
    def compared(self) -> int:
        return sum(c.compared for c in self.channels.values())

    @property
    def verdict(self) -> str:
        if self.first is not None:
            return "different"
        if self.damage:
            return "damaged"
        return "incomplete" if self.stops else "identical"

    def as_dict(self) -> dict:
        first = self.first
        return dict(
            file=self.file,
            verdict=self.verdict,
            cut_off=self.cut_off,
            compared=self.compared,
            channels={topic: c.as_dict() for topic, c in self.channels.items()},
            first_difference=first and dict(topic=first.topic, index=first.index, stamp_ns=first.stamp_ns,
                                            field=first.field, recorded=first.recorded, recomputed=first.recomputed),
            damage=list(self.damage),
            stopped=[dict(robot=s.robot or "/", stamp_ns=s.stamp_ns, reason=s.reason) for s in self.stops],
            recorded_version=self.version,
            version=__version__,
        )  # fmt: skip


def recompute(path, progress=None) -> Recomputed:
    """Recompute a recording; progress(messages done, of all). Raises RecordingError, ConfigError where that cannot
    be tried at all."""
    with Recording(path) as recording:
        robots = Robots(recording)
        robots.feed(progress)
        channels = {c.topic: c for robot in robots.robots.values() for c in robot.channels.values()}
        firsts = [c.first for c in channels.values() if c.first]
        stops = [stop for robot in robots.robots.values() for stop in robot.stops]
        for robot in robots.robots.values():
            stops += incomplete(robot, recording.cut_off)
        version = recording.metadata().get("kr270_milling", {}).get("kr270_milling_version", "")
        first = min(firsts, key=lambda d: d.order, default=None)
        damage = () if recording.cut_off else tuple(findings(recording))
        return Recomputed(str(recording.path), recording.cut_off, channels, first, tuple(stops), version, damage)
