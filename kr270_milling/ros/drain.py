"""Listeners that are not in a hurry: their messages wait in the reader and are taken some times a second, all at once.

A recorder beside a robot and a cut that answer each other 2,000 times a second would otherwise be woken for every
message; on two cores that costs the loop more than the recording itself.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable

from rclpy.callback_groups import CallbackGroup
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

__all__ = ["DRAIN_PERIOD", "DEPTH", "Taken", "as_available", "aside", "drain", "in_order", "is_aside"]

DRAIN_PERIOD = 0.02  # [s] of the wall
DEPTH = 20_000  # messages that may wait in the reader
AGAIN = 5_000_000_000  # [ns] that a message which was lost may take to come again; more is a clock that was set back
#: (arrival, publication [ns of the wall clock], callback, message as bytes)
Taken = tuple[int, int, Callable, bytes]


class Aside(CallbackGroup):
    """Never ready, so that no executor waits for its subscriptions."""

    def can_execute(self, entity) -> bool:
        return False

    def beginning_execution(self, entity) -> bool:
        return False

    def ending_execution(self, entity) -> None: ...


def is_aside(subscription: Subscription) -> bool:
    """Whether it is one of ``aside``."""
    return isinstance(subscription.callback_group, Aside)


def aside(node, kind: type, topic: str, callback: Callable, qos: QoSProfile) -> Subscription:
    """A raw subscription for ``drain``, with a long queue."""
    long = QoSProfile(history=qos.history, depth=DEPTH, reliability=qos.reliability, durability=qos.durability)
    return node.create_subscription(kind, topic, callback, long, callback_group=Aside(), raw=True)


def drain(subscriptions: Iterable[Subscription]) -> list[Taken]:
    """Everything that has arrived, in the order of arrival."""
    taken: list[list[Taken]] = []
    for subscription in subscriptions:
        handle, series = subscription.handle, []
        with handle:
            while (found := handle.take_message(subscription.msg_type, True)) is not None:
                data, info = found
                series.append((info["received_timestamp"], info["source_timestamp"], subscription.callback, data))
        taken.append(as_available(series))
    return in_order(taken)


def as_available(series: list[Taken]) -> list[Taken]:
    """Of one reader. What came while a lost message was sent again waited in the reader: it has come with that one."""
    latest = 0
    found: list[Taken] = []
    for arrived, published, callback, data in series:
        latest = latest if 0 < latest - arrived < AGAIN else arrived
        found.append((latest, published, callback, data))
    return found


def in_order(series: list[list[Taken]]) -> list[Taken]:
    """Those of several readers by arrival. Each reader has its own in order, whatever the wall clock did meanwhile."""
    back: list[tuple[int, int]] = [
        (new[0], old[0]) for one in series for old, new in itertools.pairwise(one) if new[0] < old[0]
    ]
    if not back:
        return sorted((item for one in series for item in one), key=lambda item: item[0])
    _, below, above = min((new - old, new, old) for new, old in back)
    middle = (below + above) // 2  # the clock was set back: from above to below this
    keyed = []
    for one in series:
        latest = (False, 0)
        for item in one:
            latest = max(latest, (item[0] < middle, item[0]))
            keyed.append((latest, item))
    return [item for _, item in sorted(keyed, key=lambda pair: pair[0])]
