"""Recordings of a graph whose topics were remapped: the recorded names become ours, with rules in the syntax of ROS."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

from kr270_milling.base.errors import InputError, nearest
from kr270_milling.recordings.messages.topics import TOPICS

__all__ = ["namespaces_of", "own_name", "remapping"]

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


def own_name(topic: str, remap: Mapping[str, str], namespaces: Collection[str]) -> str:
    """Return our name of a recorded topic; a recorded topic that has our name by chance gets the other one.

    A relative name belongs to each of the namespaces of robots.
    """
    for own, recorded in remap.items():
        for space in [""] if recorded.startswith("/") else namespaces:
            names = [f"{space}/{name.lstrip('/')}" for name in (recorded, own)]
            if topic in names:
                return names[topic == names[0]]
    return topic


def namespaces_of(topics: Iterable[str]) -> set[str]:
    """Return the namespaces that may be those of robots: of every topic with one of our names."""
    return {space for space, _, name in (topic.rpartition("/") for topic in topics) if name in OWN}
