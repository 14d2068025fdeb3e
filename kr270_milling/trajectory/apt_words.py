"""Words of APT that change no path, and those that cannot be run with advice."""

from __future__ import annotations

__all__ = ["ADVICE", "FEEDS", "LENGTHS", "SILENT"]

LENGTHS = {"MM": 1e-3, "INCHES": 0.0254, "INCH": 0.0254, "IN": 0.0254, "CM": 1e-2}
#: unit of FEDRAT -> length [m] and whether it is per revolution
FEEDS = {"MMPM": (1e-3, False), "IPM": (0.0254, False), "PERMIN": (None, False), "MMPR": (1e-3, True),
         "IPR": (0.0254, True), "PERREV": (None, True)}  # fmt: skip

#: words without effect on the path
SILENT = frozenset({"REMARK", "MACHIN", "COOLNT", "DISPLY", "PAINT", "INTOL", "OUTTOL", "TOLER", "END-OF-PATH", "STOP",
                    "OPSTOP", "OPSKIP", "DELAY", "DWELL", "REWIND", "SEQNO", "AUXFUN", "PREFUN", "INSERT", "LEADER",
                    "CLEARP", "CLEARANCE", "CHECK", "SETMODE", "MODE", "CATPROCESS", "OP", "TPRINT", "CAMERA", "HEAD",
                    "ROTABL", "THICK", "ORIGIN", "LETTER", "OVPLOT", "PIVOTZ", "RETRCT",
                    "SAFETY", "SELECT", "SET", "MCHTOL", "ARCSLP", "POSTN", "PLUNGE", "BREAK"})  # fmt: skip
MACROS = "let the CAM output CL data without macros, loops and geometry statements"
CYCLES = "let the CAM output drilling as GOTO moves"
ARCS = "let the CAM output arcs as CIRCLE/ about z or as GOTO moves"
DATUM = "let the CAM output coordinates of one system"
ADVICE = {"CYCLE": CYCLES, "TLON": ARCS, "INDIRV": ARCS, "GOFWD": ARCS, "NURBS": ARCS, "ARCMOV": ARCS, "MOVARC": ARCS,
          "HELIX": ARCS, "CUTCOM": "let the CAM output the path of the tool's centre", "TRACUT": DATUM, "TRANS": DATUM,
          "COPY": DATUM, "CSYS": DATUM, "ROTATE": DATUM, "LOOPST": MACROS, "LOOPND": MACROS, "MACRO": MACROS,
          "CALL": MACROS, "IF": MACROS, "JUMPTO": MACROS, "TERMAC": MACROS, "THREAD": "leave threads out",
          "PROBE": "leave probing out", "": "post CL data of a 3-axis mill: GOTO, CIRCLE, FEDRAT, RAPID"}  # fmt: skip
