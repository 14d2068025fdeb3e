"""Telegrams of KUKA RobotSensorInterface: the state of the robot as XML in, the correction as XML out.

Elements of the telegram of the robot: RIst (actual pose), RSol (commanded pose), AIPos (joint positions), Delay (late
answers), IPOC (cycle counter [ms]). The answer carries RKorr, or AK for corrections of joints, and repeats the IPOC.
The ETHERNET file of a context may name them otherwise. Source: KUKA.RobotSensorInterface 3, object ETHERNET.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from kr270_milling.base.errors import InputError, MessageError

MOST_BYTES = 4096  #: size of a telegram; with all internal values it has about 1200
AXES = ("X", "Y", "Z", "A", "B", "C")
JOINTS = tuple(f"A{k}" for k in range(1, 7))
UNITS = np.array([1e-3, 1e-3, 1e-3, *(np.pi / 180.0,) * 3])  # mm and degrees -> m and rad


@dataclass(frozen=True, eq=False)
class RobotTelegram:
    """A telegram of the robot; poses are X, Y, Z [m], A, B, C [rad], (6,), of $TOOL in $BASE."""

    ipoc: int  #: cycle counter [ms]
    actual: np.ndarray | None  #: RIst
    commanded: np.ndarray | None  #: RSol
    delay: int  #: answers in a row that reached the robot too late
    joints: np.ndarray | None = None  #: AIPos [rad], (6,)


@dataclass(frozen=True)
class Elements:
    """Names of the elements of a context; empty: the robot does not send the element."""

    sensor: str = "ImFree"  #: SENTYPE
    actual: str = "RIst"
    commanded: str = "RSol"
    joints: str = ""
    correction: str = "RKorr"
    axes: tuple[str, ...] = AXES  #: attributes of ``correction``

    @property
    def of_joints(self) -> bool:
        """Return whether the correction is that of joints."""
        return self.axes == JOINTS


def read_elements(path) -> Elements:
    """Read the ETHERNET file of a context; raise InputError for a file without a correction that can be given."""
    try:
        root = ElementTree.fromstring(Path(path).read_bytes())  # noqa: S314 (the file of the user)
    except (OSError, ElementTree.ParseError) as error:
        raise InputError(path, f"is no XML file of the object ETHERNET ({error})") from None
    sent, received = (_elements(root, part) for part in ("SEND", "RECEIVE"))
    poses = [name for name, axes in sent.items() if set(AXES) <= set(axes)]
    joints = [name for name, axes in sent.items() if set(JOINTS) <= set(axes)]
    shifts = {name: tuple(a for a in axes if a in AXES) for name, axes in received.items() if set("XYZ") <= set(axes)}
    turns = {name: JOINTS for name, axes in received.items() if set(JOINTS) <= set(axes)}
    corrections = list((shifts or turns).items())
    if not corrections:
        raise InputError(path, "RECEIVE has no element with X, Y, Z or with A1 to A6, so no correction can be given")
    if len(corrections) > 1:
        corrections = [item for item in corrections if item[0] in ("RKorr", "AK")]
    if len(corrections) != 1:
        raise InputError(path, f"RECEIVE has several elements for a correction: {', '.join(shifts or turns)}")
    (correction, axes), names = corrections[0], [*poses, *joints]
    actual = next((name for name in ("RIst", *poses) if name in poses and name != "RSol"), "")
    angles = next((name for name in ("ASPos", "AIPos", *joints) if name in joints), "")
    if not names or (axes == JOINTS and not angles):
        missing = "joint positions A1 to A6" if axes == JOINTS else "pose X, Y, Z, A, B, C"
        raise InputError(path, f"SEND has no element with the {missing}")
    sensor = (root.findtext("CONFIG/SENTYPE") or "").strip()
    if not all(re.fullmatch(r"[A-Za-z_][\w.-]{0,63}", name) for name in (sensor, correction)):
        raise InputError(path, "SENTYPE and the names of elements must be names of XML")
    return Elements(sensor, actual, "RSol" if "RSol" in poses else "", angles, correction, axes)


def _elements(root: ElementTree.Element, part: str) -> dict[str, list[str]]:
    """Name of an element -> its attributes; internal values have those that RSI gives them."""
    names: dict[str, list[str]] = {}
    for element in root.iterfind(f"{part}/ELEMENTS/ELEMENT"):
        name, _, attribute = element.get("TAG", "").removeprefix("DEF_").partition(".")
        internal = {"RIst": AXES, "RSol": AXES, "AIPos": JOINTS, "ASPos": JOINTS}
        names.setdefault(name, []).extend([attribute] if attribute else internal.get(name, ()))
    return names


def read_telegram(data: bytes, elements: Elements = Elements()) -> RobotTelegram:
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
    delay, joints = root.find("Delay"), _numbers(root, elements.joints, JOINTS)
    return RobotTelegram(
        _counter(root.findtext("IPOC"), "IPOC"),
        _pose(root, elements.actual),
        _pose(root, elements.commanded),
        0 if delay is None else _counter(delay.get("D"), "Delay"),
        None if joints is None else np.radians(joints),
    )


def _counter(text: str | None, name: str) -> int:
    if text is None or not re.fullmatch(r"\d{1,18}", text.strip()):
        raise MessageError(f"a telegram has no whole number in {name}")
    return int(text)


def _numbers(root: ElementTree.Element, name: str, attributes: tuple[str, ...]) -> np.ndarray | None:
    element = root.find(name) if name else None
    if element is None:
        return None
    try:
        values = np.array([float(element.attrib[attribute]) for attribute in attributes])
    except (KeyError, ValueError):
        raise MessageError(f"{name} of a telegram needs numbers for {', '.join(attributes)}") from None
    if not np.isfinite(values).all():
        raise MessageError(f"{name} of a telegram is not finite")
    return values


def _pose(root: ElementTree.Element, name: str) -> np.ndarray | None:
    farthest = 100.0  # [m]
    values = _numbers(root, name, AXES)
    if values is None:
        return None
    pose = values * UNITS
    if np.abs(pose[:3]).max() > farthest:
        raise MessageError(f"{name} of a telegram is farther than {farthest:g} m")
    return pose


def write_answer(ipoc: int, correction: np.ndarray, elements: Elements = Elements()) -> bytes:
    """Return the answer to the cycle ``ipoc``.

    correction: X, Y, Z [m], A, B, C [rad], (6,), absolute, in $BASE; for ``axes`` A1 to A6 of the joints [rad].
    """
    units = np.full(6, np.pi / 180.0) if elements.of_joints else UNITS
    values = dict(zip(JOINTS if elements.of_joints else AXES, correction / units + 0.0, strict=True))
    texts = " ".join(f'{axis}="{values[axis]:.4f}"' for axis in elements.axes)
    return f'<Sen Type="{elements.sensor}"><{elements.correction} {texts}/><IPOC>{ipoc}</IPOC></Sen>'.encode()
