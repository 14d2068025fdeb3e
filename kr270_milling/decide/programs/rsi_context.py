"""The RSI context of a KR C4 (RSI 3): six corrections from ETHERNET to POSCORR, in $BASE; and the program around it.

The numbers of objects and parameters are those of two public projects that run such a context: otherworld-dev/rsi-pi
(KR 16-2, KSS 8.3) and cjlh/kuka-rsi-ros-interface (KR 3 R540, KSS 8.3, RSI 3.3). Precision and time-out are those of
ros-industrial/kuka_experimental. RSI 5 reads another format.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Iterable
from pathlib import Path

from kr270_milling.base.errors import InputError
from kr270_milling.base.files import write_files
from kr270_milling.cell.sections import Program
from kr270_milling.decide.programs import krl
from kr270_milling.decide.programs.krl_motion import frame_row, frame_text

PORT = 49152  #: default port of the command ``rsi``


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
    directory,
    program: Program,
    setup: krl.Setup,
    limit: float,
    address: tuple[str, int],
    notes: list[str],
    parts: int = 1,
) -> list[Path]:
    """Write ETHERNET settings, context and frame program, which runs NAME_ORG; return the paths.

    limit [m]: largest displacement along each axis of $BASE; address: of the host of ``kr270_milling rsi``; notes:
    comment lines of the header; parts: a frame program for each part of NAME_ORG, NAME_RSI_P1 runs NAME_ORG_P1.
    """
    name, place = program.name, Path(directory)
    tool, base = (f"{{{frame_text(frame_row(frame))}}}" for frame in (setup.tool, setup.base))
    host, port = address
    limits = {f"LowerLim{axis}": f"{-1e3 * limit:g}" for axis in "XYZ"}  # [mm]
    limits |= {f"UpperLim{axis}": f"{1e3 * limit:g}" for axis in "XYZ"}
    limits["MaxRotAngle"] = "0.5"  # [deg], that of the command ``rsi`` by default
    words = dict(program=program, tool=tool, base=base, host=host, port=port, limits=limits.items())
    files: dict[Path, Iterable[str]] = {}
    for part in [f"_P{n}" for n in range(1, parts + 1)] if parts > 1 else [""]:
        body, context, model, ethernet = krl.filled("rsi_program.txt", part=part, **words).split("\u00b6\n")
        source = [*krl.HEAD, f"DEF {name}_RSI{part}( )", *notes, *body.splitlines(), "END"]
        files[place / f"{name}_RSI{part}.src"] = [f"{line}\r\n" for line in source]
    files |= {
        place / f"{name}.rsi.xml": [context],
        place / f"{name}.rsi": [model],
        place / f"{name}_ethernet.xml": [ethernet],
    }
    write_files(files, newline="")
    return list(files)
