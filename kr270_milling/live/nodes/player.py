"""Node: play a recording back onto topics, as serialised messages."""

from __future__ import annotations

import argparse
import functools
import sys
import time
from collections.abc import Callable

from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from kr270_milling.base.arguments import PLAY, end_process
from kr270_milling.base.errors import MillingError, RecordingError, nearest, one_line
from kr270_milling.live.ros.node import ERROR, OK, WARN, ReportingNode, stamp_from_ns
from kr270_milling.live.ros.spin import own_arguments, run_node
from kr270_milling.live.ros.topics import message_class
from kr270_milling.recordings.bag.files import is_latched, read_qos
from kr270_milling.recordings.bag.mcap_file import RawMessage
from kr270_milling.recordings.bag.reader import Recording, playback, span

DEPTH = 1000  # messages that may wait for a slow reader


class PlayClock:
    """Position of a playback [ns of log time], from readings [s] of any clock that does not go back."""

    def __init__(self, start: int, rate: float, now: float, paused: bool = False):
        self.rate, self.paused = rate, paused
        self._position, self._since = start, now

    def position(self, now: float) -> int:
        if self.paused:
            return self._position
        return self._position + int(max(now - self._since, 0.0) * self.rate * 1e9)

    def set_paused(self, paused: bool, now: float) -> None:
        self._position, self._since, self.paused = self.position(now), now, paused


class Player(ReportingNode):
    """Publish the messages of a recording at the pace of their log times; end after the last message."""

    def __init__(self, args: argparse.Namespace, progress: Callable | None = None, **kwargs):
        """args: ``file`` and the options of ``PLAY``; progress: called with (ns played, ns in all)."""
        self.recording = Recording(args.file)
        try:
            super().__init__("player", **kwargs)
            self._prepare(args)
        except BaseException:
            self.recording.close()
            raise
        self._progress = progress
        self.count = 0
        for name, paused in (("pause", True), ("resume", False), ("toggle_paused", None)):
            self.serve(f"~/{name}", functools.partial(self._set_paused, paused))
        self._timer = self.create_timer(0.001, self._tick)  # [s]
        self.report(OK, "paused" if args.start_paused else "playing")

    def _prepare(self, args: argparse.Namespace) -> None:
        known = self.recording.topics()
        missing = sorted(set(args.topics or ()) - set(known))
        if missing:
            raise RecordingError(self.recording.path, f"has no topic {', '.join(missing)}{nearest(missing[0], known)}")
        wanted = {topic: about for topic, about in known.items() if about.count and topic in (args.topics or known)}
        if args.clock is not None:
            wanted.pop("/clock", None)
        outlets = {topic: self._outlet(topic, about) for topic, about in wanted.items()}
        self._outlets = {topic: outlet for topic, outlet in outlets.items() if outlet is not None}
        if not self._outlets:
            raise RecordingError(self.recording.path, "contains no message that can be played")
        self._clock_publisher = self.create_publisher(Clock, "/clock", 10) if args.clock else None
        self._clock_period = max(1, int(1e9 * args.rate / (args.clock or 1.0)))  # [ns] of log time
        self._start, self._end = span(self.recording, args.start_offset, args.playback_duration)
        self._clock_due = self._start  # log time [ns] of the next /clock
        self._pace = PlayClock(self._start, args.rate, time.monotonic(), args.start_paused)
        self._messages = playback(self.recording, set(self._outlets), self._start, self._end)
        self._next: RawMessage | None = None

    def _outlet(self, topic: str, about):
        """Create the publisher of a topic; return None, with a warning, where name or type cannot be used."""
        try:
            if about.encoding != "cdr":
                raise MillingError(f"its encoding is {about.encoding}")
            # a namespace of the player does not move the topics of the whole graph
            common = topic in ("/clock", "/diagnostics", "/rosout", "/parameter_events", "/tf", "/tf_static")
            name = topic if common else topic.lstrip("/")
            return self.create_publisher(message_class(about.type), name, qos_of(about))
        except (MillingError, NameValidationException, ValueError, ImportError) as error:
            self.get_logger().warning(one_line(f"{topic} is not played: {error}"))
            return None

    def _tick(self) -> None:
        if self.finished or self._pace.paused:
            return
        position = self._pace.position(time.monotonic())
        for _ in range(500):  # signals and services are handled in between
            try:
                self._next = self._next or next(self._messages, None)
            except RecordingError as error:  # nothing can be read after a damage
                self.end(str(error))
                self.report(ERROR, str(error))
                return
            if self._next is None:
                self.end()
                return
            if self._next.log_time > position:
                break
            message, self._next = self._next, None
            self._outlets[message.topic].publish(message.data)
            self.count += 1
            if self._progress is not None:
                self._progress(max(message.log_time - self._start, 0), max(self._end - self._start, 1))
        if self._clock_publisher is not None and position >= self._clock_due:
            self._clock_publisher.publish(Clock(clock=stamp_from_ns(position)))
            self._clock_due += self._clock_period * ((position - self._clock_due) // self._clock_period + 1)

    def _set_paused(self, wanted: bool | None) -> str:
        """Pause or resume, and return the state; wanted: None toggles."""
        paused = not self._pace.paused if wanted is None else wanted
        self._pace.set_paused(paused, time.monotonic())
        state = "paused" if paused else "playing"
        self.report(WARN if paused else OK, state)
        return state

    def watch(self) -> dict:
        return {"messages": getattr(self, "count", 0)}

    def close(self) -> None:
        """After the last message: wait until the subscribers have received it, and close the file."""
        if self.finished:
            for outlet in self._outlets.values():
                outlet.wait_for_all_acked(Duration(seconds=1))
        self.recording.close()
        self.get_logger().info(f"{self.count} messages played")


def qos_of(about) -> QoSProfile:
    """Return a recorded topic's quality of service: reliable or latched only if all its publishers were.

    Discovery does not report the depth; an unknown depth becomes 1 for latched topics, else ``DEPTH``.
    """
    profiles = read_qos(about.metadata.get("offered_qos_profiles", ""))
    latched = is_latched(about.metadata)
    reliable = all(p.get("reliability") in ("reliable", "system_default", 1, 0) for p in profiles)
    depths = [p["depth"] for p in profiles if isinstance(p.get("depth"), int) and 0 < p["depth"] <= DEPTH]
    return QoSProfile(
        depth=max(depths, default=1 if latched else DEPTH),
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def run_player(
    args: argparse.Namespace, ros_args: list[str] | None = None, progress: Callable | None = None
) -> tuple[int, int]:
    """Run the player as this process; return its exit code and the number of published messages."""
    players: list[Player] = []

    def make(**kwargs) -> Player:
        players.append(Player(args, progress, **kwargs))
        return players[0]

    code = run_node(make, ros_args or [])
    return code, sum(player.count for player in players)


def player_main() -> int:
    """Console script ``player``."""
    parser = argparse.ArgumentParser(
        prog="player", description="Play a recording back onto topics.", epilog="example: player out/pass1 --rate 0.5"
    )
    parser.add_argument("file", metavar="FILE.mcap|DIR", help="a recording")
    for names, keywords in PLAY:
        parser.add_argument(*names, **keywords)
    code, _ = run_player(parser.parse_args(own_arguments()), sys.argv)
    return end_process(code)
