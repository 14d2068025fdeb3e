"""Listeners that are not in a hurry: their messages wait in the reader and are taken some times a second, all at once.

A recorder beside a robot and a cut that answer each other 2,000 times a second would otherwise be woken for every
message; on two cores that costs the loop more than the recording itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from rclpy.callback_groups import CallbackGroup
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

__all__ = ["DRAIN_PERIOD", "DEPTH", "Taken", "aside", "drain"]

DRAIN_PERIOD = 0.02  # [s] of the wall
DEPTH = 20_000  # messages that may wait in the reader
#: (arrival, publication [ns of the wall clock], callback, message as bytes)
Taken = tuple[int, int, Callable, bytes]


class Aside(CallbackGroup):
    """Never ready, so that no executor waits for its subscriptions."""

    def can_execute(self, entity) -> bool:
        return False

    def beginning_execution(self, entity) -> bool:
        return False

    def ending_execution(self, entity) -> None: ...


def aside(node, kind: type, topic: str, callback: Callable, qos: QoSProfile) -> Subscription:
    """A raw subscription for ``drain``, with a long queue."""
    long = QoSProfile(history=qos.history, depth=DEPTH, reliability=qos.reliability, durability=qos.durability)
    return node.create_subscription(kind, topic, callback, long, callback_group=Aside(), raw=True)


def drain(subscriptions: Iterable[Subscription]) -> list[Taken]:
    """Everything that has arrived, in the order of arrival."""
    taken: list[Taken] = []
    for subscription in subscriptions:
        handle = subscription.handle
        with handle:
            while (found := handle.take_message(subscription.msg_type, True)) is not None:
                data, info = found
                taken.append((info["received_timestamp"], info["source_timestamp"], subscription.callback, data))
    taken.sort(key=lambda item: item[0])
    return taken
