"""Subscriptions that no executor serves: a node takes their messages some times a second, all at once.

A recorder next to a robot and a cut that exchange 2,000 times a second would wake up for every message. On two cores
that takes more of the exchange rate than the recording itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

from rclpy.callback_groups import CallbackGroup
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from kr270_milling.live.ros.rclpy_private import take_messages

__all__ = ["DEPTH", "POLL_PERIOD", "PolledMessage", "in_order", "is_polled", "poll", "polled_subscription"]

POLL_PERIOD = 0.01  # [s] of the wall clock
DEPTH = 20_000  # messages that may wait in a subscription


class PolledMessage(NamedTuple):
    """A serialised message and where it goes."""

    arrival: int  #: [ns of the wall clock]; never decreases within the messages of one subscription and one poll
    published: int  #: [ns of the wall clock]
    callback: Callable
    data: bytes


class Polled(CallbackGroup):
    """A callback group that is never ready, so that no executor waits for its subscriptions."""

    def can_execute(self, entity) -> bool:
        return False

    def beginning_execution(self, entity) -> bool:
        return False

    def ending_execution(self, entity) -> None: ...


def is_polled(subscription: Subscription) -> bool:
    """Return whether ``polled_subscription`` created the subscription."""
    return isinstance(subscription.callback_group, Polled)


def polled_subscription(node, kind: type, topic: str, callback: Callable, qos: QoSProfile) -> Subscription:
    """Create a subscription for ``poll``: serialised messages, a queue of ``DEPTH``."""
    deep = QoSProfile(history=qos.history, depth=DEPTH, reliability=qos.reliability, durability=qos.durability)
    return node.create_subscription(kind, topic, callback, deep, callback_group=Polled(), raw=True)


def poll(subscriptions: Iterable[Subscription]) -> list[PolledMessage]:
    """Take every message that has arrived, in the order of arrival."""
    return in_order([message for subscription in subscriptions for message in _taken(subscription)])


def in_order(messages: Iterable[PolledMessage]) -> list[PolledMessage]:
    """Sort messages by arrival; messages of equal arrival keep their order."""
    return sorted(messages, key=lambda message: message.arrival)


def _taken(subscription: Subscription) -> list[PolledMessage]:
    """Return the messages of one subscription.

    A message that arrives before a lost one is sent again waits for the lost message, so it counts as arriving then.
    """
    messages: list[PolledMessage] = []
    arrival = 0
    for data, info in take_messages(subscription):
        arrival = max(arrival, info["received_timestamp"])
        messages.append(PolledMessage(arrival, info["source_timestamp"], subscription.callback, data))
    return messages
