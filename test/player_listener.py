"""A player of a recording and a node that hears it, for the tests of the player."""

from __future__ import annotations

import argparse
import time

from kr270_milling.bag.play_options import PlayOptions
from kr270_milling.nodes.play_arguments import PLAY, play_options

FIRST = ("/compensator_state", "/reference_trajectory", "/joint_trajectory")


def options(*words: str) -> PlayOptions:
    parser = argparse.ArgumentParser()
    parser.add_argument("file")
    for names, how in PLAY:
        parser.add_argument(*names, **how)
    return play_options(parser.parse_args(list(words)))


class Listener:
    """A player and a node that hears it, in a world of their own, stepped by hand."""

    def __init__(self, domain: int, bag, words=(), names=("/tool_pose", "/wrench", *FIRST), arguments=()):
        import rclpy
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node

        from kr270_milling.nodes.player import Player
        from kr270_milling.ros import topics
        from kr270_milling.ros.environment import keep_to_this_host

        keep_to_this_host()
        self.context = Context()
        rclpy.init(args=[], context=self.context, domain_id=domain)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.node = Node("listener", context=self.context, use_global_arguments=False)
        self.executor.add_node(self.node)
        self.heard: list[tuple[str, bytes]] = []
        self.times: dict[str, list[float]] = {}
        self.player = Player(
            options(str(bag), "--start-paused", *words), context=self.context, cli_args=["--ros-args", *arguments]
        )
        for name in names:
            topic = topics.BY_NAME[name.rpartition("/")[2]]
            kind, qos = topic.type, topics.LATCHED if topic.qos is topics.LATCHED else 1000
            self.node.create_subscription(kind, name, lambda data, n=name: self._hear(n, data), qos, raw=True)
        self.until(lambda: all(self.node.count_publishers(name) for name in names))
        self.executor.add_node(self.player)
        matched = [o for t, o in self.player._outlets.items() if t in names]
        self.until(lambda: all(o.get_subscription_count() for o in matched))

    def _hear(self, name: str, data: bytes) -> None:
        self.heard.append((name, data))
        self.times.setdefault(name, []).append(time.monotonic())

    def until(self, reached, limit: float = 30.0) -> None:
        end = time.monotonic() + limit
        while not reached():
            assert time.monotonic() < end, f"waited in vain; {len(self.heard)} messages heard"
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
        return self.heard

    def settle(self) -> None:
        """Hear on until nothing has come for half a second."""
        quiet_from, count = time.monotonic(), len(self.heard)
        while time.monotonic() < quiet_from + 0.5:
            self.executor.spin_once(timeout_sec=0.02)
            if len(self.heard) != count:
                quiet_from, count = time.monotonic(), len(self.heard)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.player.close()
        self.executor.shutdown()
        self.player.destroy_node()
        self.node.destroy_node()
        self.context.try_shutdown()
