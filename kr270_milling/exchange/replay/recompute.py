"""Recompute a recording: feed its inputs to the protocols of the nodes and compare the outputs bit for bit.

There is no ROS graph and no clock: the messages come in the order of the file. Robots in several namespaces are
recomputed together, with the cell of the recording.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from kr270_milling.base.errors import RecordingError
from kr270_milling.base.version import __version__
from kr270_milling.exchange.replay.compare import Channel, Difference
from kr270_milling.exchange.replay.robots import Robot, Robots, Stop
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.verify import findings

__all__ = ["Recomputed", "recompute"]

EXCHANGE = ("tool_pose", "wrench")
UNDER_WAY = 10  # exchange periods at the end of a pass that broke off, in which causes or effects may be missing
LIBRARY = re.compile(r"kr270_milling/(\d+\.\d+)\.")


@dataclass(frozen=True)
class Recomputed:
    """The verdict of a recompute.

    "different": one message at least has other bits; "damaged": a checksum or an index of the file does not fit;
    "incomplete": a model could not continue, or messages were not compared; else "identical".
    """

    file: str
    cut_off: bool
    channels: dict[str, Channel]
    first: Difference | None
    stops: tuple[Stop, ...]
    version: str  #: of the package that wrote the recording
    damage: tuple[str, ...] = ()  #: checksums and indices that do not fit

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
        return dict(
            file=self.file,
            verdict=self.verdict,
            cut_off=self.cut_off,
            compared=self.compared,
            channels={topic: c.as_dict() for topic, c in self.channels.items()},
            first_difference=self.first and {k: v for k, v in vars(self.first).items() if k != "order"},
            damage=list(self.damage),
            stopped=[vars(stop) | {"robot": stop.robot or "/"} for stop in self.stops],
            recorded_version=self.version,
            version=__version__,
        )


def recompute(path, progress=None, remap: Mapping[str, str] = MappingProxyType({})) -> Recomputed:
    """Recompute a recording; progress(messages done, of all); remap: see ``Recording``.

    Raises RecordingError and ConfigError where a recompute is not possible, as for a recording of another version.
    """
    with Recording(path, remap=remap) as recording:
        _expect_this_version(recording)
        recomputed = Robots(recording)
        recomputed.feed(progress)
        recomputed.finish()
        _expect_exchange(recording, recomputed)
        robots, cut_off = recomputed.robots.values(), recording.cut_off
        channels = {channel.topic: channel for robot in robots for channel in robot.channels.values()}
        firsts = [channel.first for channel in channels.values() if channel.first]
        first = min(firsts, key=lambda difference: difference.order, default=None)
        stops = [stop for robot in robots for stop in robot.stops]
        stops += [stop for robot in robots if not robot.stops for stop in _incomplete(robot, cut_off)]
        version = recording.metadata().get("kr270_milling", {}).get("kr270_milling_version", "")
        damage = () if cut_off else tuple(findings(recording))
        return Recomputed(str(recording.path), cut_off, channels, first, tuple(stops), version, damage)


def _expect_this_version(recording: Recording) -> None:
    """Raise RecordingError where another minor version of this package wrote the recording."""
    recorded = LIBRARY.match(recording.library)
    if recorded and recorded[1] != ".".join(__version__.split(".")[:2]):
        version = recording.library.partition("/")[2]
        raise RecordingError(recording.path, f"recorded by {version}; recompute it with that version")


def _expect_exchange(recording: Recording, recomputed: Robots) -> None:
    """Raise RecordingError where the poses are those of a driver: nothing of the package computed these poses."""
    poses = [robot.channels["tool_pose"] for robot in recomputed.robots.values() if "tool_pose" in robot.channels]
    if poses and all(channel.refused == channel.count > 0 for channel in poses):
        reason = (
            "its poses have the stamps of a driver, not of an exchange, and cannot be recomputed; report scores them"
        )
        raise RecordingError(recording.path, reason)


def _incomplete(robot: Robot, cut_off: bool) -> Iterator[Stop]:
    """Return why the recompute of a robot is not complete, although its models did not stop.

    Where a pass or the file broke off, the last periods may lack causes or effects.
    """
    namespace, exchange, done = robot.namespace, robot.cell.exchange, robot.robot.protocol.done
    names = [name for name, c in robot.channels.items() if c.waiting and not c.compared]
    if names:
        yield Stop(namespace, None, f"the inputs of {', '.join(names)} are not in the recording")
        return
    if not any(robot.channels[name].compared for name in EXCHANGE if name in robot.channels):
        yield Stop(namespace, None, "no pass is in the recording: no tool_pose and no wrench was compared")
        return
    allowed = 0 if done and not cut_off else UNDER_WAY * exchange.iterations
    for channel in robot.channels.values():
        if channel.waiting > allowed:
            reason = f"{channel.waiting} messages on {channel.topic} from {channel.leftover * 1e-9:.6f} s on were not "
            yield Stop(namespace, None, reason + "compared: no recorded input leads to these messages")
    under_way = round(UNDER_WAY * exchange.period * 1e9)
    for name, channel in () if cut_off else robot.channels.items():
        count = channel.lacking(under_way, done, exchange.iterations if name in EXCHANGE else 1)
        if count:
            reason = f"{count} messages that belong on {channel.topic} are not in the recording"
            yield Stop(namespace, None, reason + ", and the stamps show no gap")
