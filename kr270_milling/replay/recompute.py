"""A recording recomputed: its inputs once more through the nodes' protocols, its outputs compared bit for bit.

No ROS graph and no clock: the messages come in the order of the file. Several robots in their namespaces are recomputed
side by side, with the cell of the recording.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from kr270_milling import __version__
from kr270_milling.bag.reader import Recording
from kr270_milling.bag.verify import findings
from kr270_milling.replay.compare import Channel, Difference
from kr270_milling.replay.feeds import MOST_AHEAD
from kr270_milling.replay.robots import Robot, Robots, Stop

__all__ = ["Recomputed", "recompute"]


EXCHANGE = ("tool_pose", "wrench")


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
            stops += _incomplete(robot, recording.cut_off)
        version = recording.metadata().get("kr270_milling", {}).get("kr270_milling_version", "")
        first = min(firsts, key=lambda d: d.order, default=None)
        damage = () if recording.cut_off else tuple(findings(recording))
        return Recomputed(str(recording.path), recording.cut_off, channels, first, tuple(stops), version, damage)


class Lack(Stop):
    """Something that was not compared, although no model stopped."""

    def __str__(self) -> str:
        return f"{self.robot or '/'}: {self.reason}"


def _incomplete(robot: Robot, cut_off: bool) -> list[Stop]:
    """Why the recompute of a robot is not complete, beyond the stops of its models.

    Where a pass broke off, or the file, some periods may be under way: causes without effects, and the other way round.
    """
    if robot.stops:
        return []
    names = [name for name, c in robot.channels.items() if c.waiting and not c.compared]
    if names:
        return [Stop(robot.namespace, 0, f"the inputs of {', '.join(names)} are not in the recording")]
    if not any(robot.channels[name].compared for name in EXCHANGE if name in robot.channels):
        return [
            Lack(robot.namespace, 0, "no pass is in the recording, so that no tool_pose and no wrench was compared")
        ]
    found = list(_left_over(robot, cut_off)) + ([] if cut_off else list(_lacking(robot)))
    if not robot.revises:
        reason = "learned was another algorithm in version 0.1.0: its references are taken as they were recorded"
        found.append(Lack(robot.namespace, 0, reason))
    return found


def _left_over(robot, cut_off: bool) -> Iterator[Stop]:
    iterations = robot.cell.exchange.iterations
    allowed = 0 if robot.robot.protocol.done and not cut_off else MOST_AHEAD * iterations
    for channel in robot.channels.values():
        if channel.waiting > allowed:
            reason = f"{channel.waiting} messages on {channel.topic} from {channel.leftover * 1e-9:.6f} s on were not "
            yield Lack(robot.namespace, channel.leftover, reason + "compared, since no recorded input leads to them")


def _lacking(robot) -> Iterator[Stop]:
    exchange = robot.cell.exchange
    under_way = round(MOST_AHEAD * exchange.period * 1e9)
    for name, channel in robot.channels.items():
        count = channel.lacking(under_way, robot.robot.protocol.done, exchange.iterations if name in EXCHANGE else 1)
        if count > (name == "joint_trajectory"):  # a recorder may be stopped right behind the reference it belongs to
            reason = f"{count} messages that belong on {channel.topic} are not in the recording"
            yield Lack(robot.namespace, 0, reason + ", and no gap in the stamps tells of them")
