"""Recordings of a graph whose topics were remapped: the recorded names become ours, with rules in the syntax of ROS."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from kr270_milling.base.errors import InputError, nearest
from kr270_milling.recordings.messages.topics import TOPICS

__all__ = ["own_name", "remapping"]

OWN = tuple(topic.name for topic in TOPICS if not topic.name.startswith("/"))


def remapping(rules: Iterable[str]) -> dict[str, str]:
    """Return our name -> recorded name of rules such as ``wrench:=force/measured``; raise InputError.

    Names are relative to the namespace of a robot. Where one of the two begins with a slash, both are absolute.
    """
    result = {}
    for rule in rules:
        own, colon, recorded = rule.partition(":=")
        if not (colon and own and recorded.strip("/")):
            raise InputError("--remap", f"{rule!r} is not NAME:=RECORDED, for example wrench:=force/measured")
        name = own.rpartition("/")[2]
        if name not in OWN or (own != name and not own.startswith("/")):
            raise InputError("--remap", f"{own!r} is not one of {', '.join(OWN)}{nearest(name, OWN)}")
        absolute = own.startswith("/") or recorded.startswith("/")
        result["/" + own.lstrip("/") if absolute else own] = "/" + recorded.lstrip("/") if absolute else recorded
    return result


def own_name(topic: str, remap: Mapping[str, str]) -> str:
    """Return our name of a recorded topic; a recorded topic that has our name by chance gets the other one."""
    for own, recorded in remap.items():
        for old, new in ((recorded, own), (own, recorded)):
            if topic == old:
                return new
            if not old.startswith("/") and topic.endswith(f"/{old}"):
                return topic.removesuffix(old) + new
    return topic
