"""The command line of a playback, for the node and for the command ``replay``."""

from __future__ import annotations

import argparse
from pathlib import Path

from kr270_milling.bag.play_options import MOST, PlayOptions
from kr270_milling.nodes.option_types import bounded

__all__ = ["add_play_arguments", "play_options"]

CLOCK_RATE = 40.0  # [Hz], of --clock without a number, as in ros2 bag play
MOST_RATE = 1e6  # and of --clock [Hz]


def add_play_arguments(parser) -> None:
    """The options of ``ros2 bag play`` that the player has."""
    above, least = bounded(0.0, MOST_RATE, above=True), bounded(0.0, MOST)
    parser.add_argument("-r", "--rate", type=above, default=1.0, help="how many times as fast as recorded")
    parser.add_argument(
        "--start-offset", type=least, default=0.0, metavar="S",
        help="start so many seconds into the recording; latched messages from before come first",
    )  # fmt: skip
    parser.add_argument("--playback-duration", type=least, metavar="S", help="play so many seconds of the recording")
    parser.add_argument("-l", "--loop", action="store_true", help="begin again at the end")
    parser.add_argument("--topics", nargs="+", metavar="TOPIC", help="only these")
    parser.add_argument("-p", "--start-paused", action="store_true", help="wait for the service ~/resume")
    parser.add_argument(
        "--clock", type=above, nargs="?", const=CLOCK_RATE, metavar="HZ",
        help=f"publish /clock at this rate ({CLOCK_RATE:g} without a number) in place of the recorded one",
    )  # fmt: skip
    parser.add_argument("-d", "--delay", type=least, default=0.0, metavar="S", help="wait before the playback begins")


def play_options(args: argparse.Namespace) -> PlayOptions:
    """What was asked for; args has ``file`` and the arguments of ``add_play_arguments``."""
    topics = None if args.topics is None else tuple(args.topics)
    return PlayOptions(
        Path(args.file), args.rate, args.start_offset, args.playback_duration, args.loop, topics, args.start_paused,
        args.clock, args.delay,
    )  # fmt: skip
