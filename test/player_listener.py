"""A player of a recording and a node that receives its messages, for the tests of the player."""

from __future__ import annotations

import argparse
import functools
import threading
import time

from kr270_milling.live.nodes.play_arguments import PLAY, play_options
from kr270_milling.recordings.bag.play_options import PlayOptions

FIRST = ("/compensator_state", "/reference_trajectory")


def options(*words: str) -> PlayOptions:
    parser = argparse.ArgumentParser()
    parser.add_argument("file")
    for names, keywords in PLAY:
        parser.add_argument(*names, **keywords)
    return play_options(parser.parse_args(list(words)))


class Listener:
    """A player and a subscriber in a separate context, stepped by hand."""

    def __init__(self, domain: int, bag, words=(), names=("/tool_pose", "/wrench", *FIRST), arguments=()):
        import rclpy
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node
        from rclpy.qos import QoSProfile

        from kr270_milling.live.nodes.player import Player
        from kr270_milling.live.ros import topics
        from kr270_milling.live.ros.environment import keep_to_this_host

        keep_to_this_host()
        self.context = Context()
        rclpy.init(args=[], context=self.context, domain_id=domain)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.node = Node("listener", context=self.context, use_global_arguments=False)
        self.reader = SingleThreadedExecutor(context=self.context)
        self.reader.add_node(self.node)
        self.messages: list[tuple[str, bytes]] = []
        self.times: dict[str, list[float]] = {}
        self.player = Player(
            options(str(bag), "--start-paused", *words), context=self.context, cli_args=["--ros-args", *arguments]
        )
        subscriptions = []
        for name in names:
            topic = topics.BY_NAME[name.rpartition("/")[2]]
            qos = QoSProfile(depth=1000, durability=topic.qos.durability)  # a depth of 1 loses latched messages
            callback = functools.partial(self._on_message, name)
            subscriptions.append(self.node.create_subscription(topic.type, name, callback, qos, raw=True))
        self.ended = False
        self.thread = threading.Thread(target=self._receive)  # the player must not delay its subscriber
        self.until(lambda: all(subscription.get_publisher_count() for subscription in subscriptions))
        self.executor.add_node(self.player)
        self.thread.start()
        matched = [o for t, o in self.player._outlets.items() if t in names]
        self.until(lambda: all(o.get_subscription_count() for o in matched))

    def _receive(self) -> None:
        while not self.ended:
            self.reader.spin_once(timeout_sec=0.05)

    def _on_message(self, name: str, data: bytes) -> None:
        self.messages.append((name, data))
        self.times.setdefault(name, []).append(time.monotonic())

    def until(self, reached, limit: float = 30.0) -> None:
        end = time.monotonic() + limit
        while not reached():
            assert time.monotonic() < end, f"the condition is not met; {len(self.messages)} messages received"
            self.spin()

    def spin(self) -> None:
        """Step the player once."""
        self.executor.spin_once(timeout_sec=0.02)

    def resume(self, name: str = "/player/resume") -> None:
        from std_srvs.srv import Trigger

        client = self.node.create_client(Trigger, name)
        self.until(client.service_is_ready)
        answer = client.call_async(Trigger.Request())
        self.until(answer.done)
        assert answer.result().success

    def play(self) -> list[tuple[str, bytes]]:
        self.resume()
        self.until(lambda: self.player.done)
        self.settle()
        return self.messages

    def settle(self) -> None:
        """Spin until no message has arrived for half a second."""
        quiet_from, count = time.monotonic(), len(self.messages)
        while time.monotonic() < quiet_from + 0.5:
            self.spin()
            if len(self.messages) != count:
                quiet_from, count = time.monotonic(), len(self.messages)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.ended = True
        self.thread.join()
        self.reader.shutdown()
        self.player.close()
        self.executor.shutdown()
        self.player.destroy_node()
        self.node.destroy_node()
        self.context.try_shutdown()
