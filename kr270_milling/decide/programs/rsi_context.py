"""The RSI context of a KR C4 (RSI 3): six corrections from ETHERNET to POSCORR, in $BASE; and the program around it.

The numbers of objects and parameters are those of two public projects that run such a context: otherworld-dev/rsi-pi
(KR 16-2, KSS 8.3) and cjlh/kuka-rsi-ros-interface (KR 3 R540, KSS 8.3, RSI 3.3). Precision and time-out are those of
ros-industrial/kuka_experimental. RSI 5 reads another format.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree as Xml

from kr270_milling.base.errors import InputError
from kr270_milling.base.files import write_files
from kr270_milling.cell.sections import Program
from kr270_milling.decide.programs import krl
from kr270_milling.decide.programs.krl_motion import frame_row, frame_text

__all__ = ["rsi_address", "write_rsi_context"]

AXES = "XYZABC"
PORT = 49152  #: default port of the command ``rsi``
SCHEMA = "/Roboter/Config/System/Common/Schemes/RSIContext.xsd"


def rsi_address(text: str) -> tuple[str, int]:
    """Return host and port of "192.168.1.10" or "192.168.1.10:49152"; raise InputError."""
    host, _, port = text.partition(":")
    number = port or str(PORT)
    try:
        ipaddress.IPv4Address(host)
    except ValueError:
        raise InputError("--rsi", f"{text[:40]!r} needs the IPv4 address of the host, such as 192.168.1.10") from None
    if not (number.isascii() and number.isdecimal() and 1 <= int(number) <= 65535):
        raise InputError("--rsi", f"the port {number[:20]!r} must be a whole number from 1 to 65535")
    return host, int(number)


def write_rsi_context(
    directory, program: Program, setup: krl.Setup, limit: float, address: tuple[str, int], notes: list[str]
) -> list[Path]:
    """Write ETHERNET settings, context and frame program, which runs NAME_ORG; return the paths.

    limit [m]: largest displacement along each axis of $BASE; address: of the host of ``kr270_milling rsi``; notes:
    comment lines of the header.
    """
    name, place = program.name, Path(directory)
    tool, base = (f"{{{frame_text(frame_row(frame))}}}" for frame in (setup.tool, setup.base))
    body = krl.filled("rsi_program.txt", program=program, tool=tool, base=base, host=address[0]).splitlines()
    source = [*krl.HEAD, f"DEF {name}_RSI( )", *notes, *body, "END"]
    files: dict[Path, Iterable[str]] = {
        place / f"{name}_RSI.src": [f"{line}\r\n" for line in source],
        place / f"{name}.rsi.xml": [_text(context := _context(name, 1e3 * limit))],
        place / f"{name}.rsi": [_text(_model(context))],
        place / f"{name}_ethernet.xml": [_text(_ethernet(*address))],
    }
    write_files(files, newline="")
    return list(files)


def _text(root: Xml.Element) -> str:
    Xml.indent(root)
    return Xml.tostring(root, encoding="unicode", xml_declaration=root.tag != "ROOT") + "\n"


def _ethernet(host: str, port: int) -> Xml.Element:
    root = Xml.Element("ROOT")
    config = Xml.SubElement(root, "CONFIG")
    for tag, value in (("IP_NUMBER", host), ("PORT", port), ("SENTYPE", "ImFree"), ("ONLYSEND", "FALSE")):
        Xml.SubElement(config, tag).text = str(value)
    send = Xml.SubElement(Xml.SubElement(root, "SEND"), "ELEMENTS")
    for tag, kind in (("DEF_RIst", "DOUBLE"), ("DEF_RSol", "DOUBLE"), ("DEF_Delay", "LONG")):
        Xml.SubElement(send, "ELEMENT", TAG=tag, TYPE=kind, INDX="INTERNAL")
    receive = Xml.SubElement(Xml.SubElement(root, "RECEIVE"), "ELEMENTS")
    for index, axis in enumerate(AXES, 1):
        Xml.SubElement(receive, "ELEMENT", TAG=f"RKorr.{axis}", TYPE="DOUBLE", INDX=str(index), HOLDON="1")
    return root


def _context(name: str, limit_mm: float) -> Xml.Element:
    root = Xml.Element(
        "RSIObjects",
        {"xmlns:xsi": "http://www.w3.org/2001/XMLSchema-instance", "xsi:noNamespaceSchemaLocation": SCHEMA},
    )
    correction = Xml.SubElement(root, "RSIObject", ObjType="POSCORR", ObjTypeID="27", ObjID="POSCORR1")
    inputs = Xml.SubElement(correction, "Inputs")
    for index in range(1, 7):
        Xml.SubElement(inputs, "Input", InIdx=str(index), OutObjID="ETHERNET1", OutIdx=str(index))
    signs = [(f"{side}Lim{axis}", sign * limit_mm) for side, sign in (("Lower", -1), ("Upper", 1)) for axis in "XYZ"]
    _parameters(correction, [(key, n, f"{value:g}") for n, (key, value) in enumerate(signs, 1)])
    rotation_deg = 0.5  # largest rotation, that of the command ``rsi`` by default
    _parameters(correction, [("MaxRotAngle", 7, f"{rotation_deg:g}")])
    _parameters(correction, [("RefCorrSys", 1, "1")], IsRuntime="false")  # 1: $BASE
    ethernet = Xml.SubElement(root, "RSIObject", ObjType="ETHERNET", ObjTypeID="64", ObjID="ETHERNET1")
    _parameters(ethernet, [("ConfigFile", 1, f"{name}_ethernet.xml")], IsRuntime="false")
    timeout = 100  # cycles without an answer after which the controller ends RSI
    _parameters(ethernet, [("Timeout", 1, str(timeout)), ("Flag", 4, "1"), ("Precision", 8, "4")])
    return root


def _parameters(owner: Xml.Element, rows: list[tuple[str, int, str]], **more: str) -> None:
    parent = owner.find("Parameters")
    parent = Xml.SubElement(owner, "Parameters") if parent is None else parent
    for name, number, value in rows:
        Xml.SubElement(parent, "Parameter", {"Name": name, "ParamID": str(number), "ParamValue": value, **more})


def _model(context: Xml.Element) -> Xml.Element:
    """The same objects as RSI Visual reads them."""
    root = Xml.Element(
        "rSIModel", {"dslVersion": "1.0.0.0", "name": "", "xmlns": "http://schemas.microsoft.com/dsltools/RSIVisual"}
    )
    objects = Xml.SubElement(root, "rSIObjects")
    for one in context:
        kind, most = one.attrib["ObjType"], "64" if one.attrib["ObjType"] == "ETHERNET" else "0"
        element = Xml.SubElement(
            objects,
            "rSIElement",
            name=one.attrib["ObjID"],
            objType=kind,
            objTypeID=one.attrib["ObjTypeID"],
            maxInputs=most,
            maxOutputs=most,
        )
        inputs = Xml.SubElement(element, "rSIInPorts")
        outputs = Xml.SubElement(element, "rSIOutPorts")
        if kind == "ETHERNET":
            Xml.SubElement(inputs, "rSIInPort", name="In1", mandatory="false")
            for index in range(1, 8):  # one more than is in use, as RSI Visual writes
                Xml.SubElement(outputs, "rSIOutPort", name=f"Out{index}")
        else:
            for index, axis in enumerate(AXES, 1):
                source = Xml.SubElement(inputs, "rSIInPort", name=f"Corr{axis}", mandatory="false")
                Xml.SubElement(Xml.SubElement(source, "source"), "rSIOutPortMoniker", name=f"//ETHERNET1/Out{index}")
            Xml.SubElement(outputs, "rSIOutPort", name="Stat", signalType="Int")
            for axis in AXES:
                Xml.SubElement(outputs, "rSIOutPort", name=axis)
        parameters = Xml.SubElement(element, "rSIParameters")
        for key in one.iterfind("Parameters/Parameter"):
            _model_parameter(parameters, key.attrib)
    return root


#: parameter -> type, least and largest value of RSI Visual; others are doubles without bounds
TYPES = {
    "RefCorrSys": ("KUKA.RSIVisual.RSI_TrafoCosys", "-2147483648", "2147483647"),
    "ConfigFile": ("System.FileName", "-2147483648", "2147483647"),
    "Timeout": ("System.Int32", "0", "2147483647"),
    "Flag": ("System.Int32", "-1", "999"),
    "Precision": ("System.Int32", "1", "32"),
}


def _model_parameter(parent: Xml.Element, key: dict[str, str]) -> None:
    name, chosen = key["Name"], key["Name"] == "RefCorrSys"
    kind, least, most = TYPES.get(name, ("System.Double", "-2147483648", "2147483647"))
    runtime = {"isRuntime": "false"} if "IsRuntime" in key else {}
    value = "Base" if chosen else key["ParamValue"]
    Xml.SubElement(
        parent,
        "rSIParameter",
        {
            "name": name,
            "value": value,
            "paramType": kind,
            "minVal": least,
            "maxVal": most,
            "isEnum": str(chosen).lower(),
            **runtime,
            "index": key["ParamID"],
        },
    )
