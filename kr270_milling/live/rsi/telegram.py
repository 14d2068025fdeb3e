"""Telegrams of KUKA RobotSensorInterface: the state of the robot as XML in, the correction as XML out.

Elements of the telegram of the robot: RIst (actual pose), RSol (commanded pose), Delay (late answers), IPOC (cycle
counter [ms]). The answer carries RKorr and repeats the IPOC. Source: KUKA.RobotSensorInterface 3, object ETHERNET.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from kr270_milling.base.errors import MessageError

__all__ = ["MOST_BYTES", "RobotTelegram", "read_telegram", "write_answer"]

MOST_BYTES = 4096  #: size of a telegram; with all internal values it has about 1200
AXES = ("X", "Y", "Z", "A", "B", "C")
UNITS = np.array([1e-3, 1e-3, 1e-3, *(np.pi / 180.0,) * 3])  # mm and degrees -> m and rad
FARTHEST = 100.0  #: [m]


@dataclass(frozen=True, eq=False)
class RobotTelegram:
    """A telegram of the robot; poses are X, Y, Z [m], A, B, C [rad], (6,), of $TOOL in $BASE."""

    ipoc: int  #: cycle counter [ms]
    actual: np.ndarray | None  #: RIst
    commanded: np.ndarray | None  #: RSol
    delay: int  #: answers in a row that reached the robot too late


def read_telegram(data: bytes) -> RobotTelegram:
    """Read a telegram of the robot; raise MessageError. Document types and entities are refused."""
    if len(data) > MOST_BYTES:
        raise MessageError(f"a telegram has {len(data)} bytes, at most {MOST_BYTES} are allowed")
    try:
        text = data.decode("ascii")
        if "<!" in text:
            raise MessageError("a telegram contains a document type or a comment, which RSI does not send")
        root = ElementTree.fromstring(text)  # noqa: S314 (a text without a document type has no entities)
    except (ElementTree.ParseError, ValueError) as error:
        raise MessageError(f"a telegram is not XML ({error})") from None
    if root.tag != "Rob":
        raise MessageError(f"a telegram begins with <{root.tag[:20]}> instead of <Rob>")
    delay = root.find("Delay")
    return RobotTelegram(
        _counter(root.findtext("IPOC"), "IPOC"),
        _pose(root.find("RIst"), "RIst"),
        _pose(root.find("RSol"), "RSol"),
        0 if delay is None else _counter(delay.get("D"), "Delay"),
    )


def _counter(text: str | None, name: str) -> int:
    if text is None or not re.fullmatch(r"\d{1,18}", text.strip()):
        raise MessageError(f"a telegram has no whole number in {name}")
    return int(text)


def _pose(element, name: str) -> np.ndarray | None:
    if element is None:
        return None
    try:
        pose = np.array([float(element.attrib[axis]) for axis in AXES]) * UNITS
    except (KeyError, ValueError):
        raise MessageError(f"{name} of a telegram needs numbers for {', '.join(AXES)}") from None
    if not (np.isfinite(pose).all() and np.abs(pose[:3]).max() <= FARTHEST):
        raise MessageError(f"{name} of a telegram is not finite or farther than {FARTHEST:g} m")
    return pose


def write_answer(ipoc: int, correction: np.ndarray) -> bytes:
    """Return the answer to the cycle ``ipoc``; correction: X, Y, Z [m], A, B, C [rad], (6,), absolute, in $BASE."""
    values = " ".join(f'{axis}="{value:.4f}"' for axis, value in zip(AXES, correction / UNITS + 0.0, strict=True))
    return f'<Sen Type="ImFree"><RKorr {values}/><IPOC>{ipoc}</IPOC></Sen>'.encode()
