"""Whether a recompute compared all that it should have: what is left over in the recording, what is missing in it."""

from __future__ import annotations

from collections.abc import Iterator

from kr270_milling.replay.feeds import MOST_AHEAD
from kr270_milling.replay.robots import Robot, Stop

__all__ = ["Lack", "incomplete"]

EXCHANGE = ("tool_pose", "wrench")


class Lack(Stop):
    """Something that was not compared, although no model stopped."""

    def __str__(self) -> str:
        return f"{self.robot or '/'}: {self.reason}"


def incomplete(robot: Robot, cut_off: bool) -> list[Stop]:
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
