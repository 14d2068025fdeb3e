"""Options of a playback from the words of a command line."""

from __future__ import annotations

import argparse

from kr270_milling.live.nodes.play_arguments import PLAY, play_options
from kr270_milling.recordings.bag.play_options import PlayOptions


def options(*words: str) -> PlayOptions:
    parser = argparse.ArgumentParser()
    parser.add_argument("file")
    for names, keywords in PLAY:
        parser.add_argument(*names, **keywords)
    return play_options(parser.parse_args(list(words)))
