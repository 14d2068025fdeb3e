"""The words of APT and CL text: what their units are, what is read over, what is refused and with which advice."""

from __future__ import annotations

from kr270_milling.path.cam.machine import INCH, MM

LENGTHS = {"MM": MM, "INCHES": INCH, "INCH": INCH, "IN": INCH, "CM": 1e-2}
#: unit of FEDRAT -> length [m], None: that of UNITS, and whether it is per revolution
FEEDS = {"MMPM": (MM, False), "IPM": (INCH, False), "PERMIN": (None, False), "MMPR": (MM, True), "IPR": (INCH, True),
         "PERREV": (None, True)}  # fmt: skip
#: kind of CYCLE/ -> the cycle of G-code that makes the same hole
CYCLES = {"DRILL": 81, "FACE": 82, "DEEP": 83, "BRKCHP": 73, "REAM": 85}
#: word of CYCLE/ -> the distance that follows
DISTANCES = {"DEPTH": "depth", "FEDTO": "depth", "CLEAR": "clear", "RAPTO": "clear", "STEP": "step", "INCR": "step",
             "RETURN": "back", "RTRCTO": "back"}  # fmt: skip
#: words without effect on the path, whatever their values
SILENT = frozenset({
    "REMARK", "MACHIN", "COOLNT", "DISPLY", "PAINT", "INTOL", "OUTTOL", "TOLER", "END-OF-PATH", "STOP", "OPSTOP",
    "OPSKIP", "DELAY", "DWELL", "REWIND", "SEQNO", "LEADER", "CLEARP", "CLEARANCE", "CHECK", "SETMODE", "MODE",
    "CATPROCESS", "OP", "TPRINT", "CAMERA", "HEAD", "THICK", "LETTER", "OVPLOT", "PIVOTZ", "SELECT", "SET", "MULTAX",
    "MCHTOL", "ARCSLP", "BREAK", "UNLOAD", "TLON",
})  # fmt: skip
TEXTS = ("PARTNO", "PPRINT", "REMARK", "INSERT", "LETTER")  #: their values are text, in which $ is a character
SYSTEMS = ("MSYS", "ORIGIN", "CSYS")  #: words that set the origin of the coordinates
CENTRE = "let the CAM output the path of the tool's centre"
MILL = "post CL data of a 3-axis mill: GOTO, CIRCLE, FEDRAT, RAPID"
DATUM = "let the CAM output coordinates of one system"
MOVES = "let the CAM output this move as GOTO"
MACROS = "let the CAM output CL data without macros, loops and geometry statements"
ADVICE = {
    "CYCLE": "let the CAM output drilling as GOTO moves", "THREAD": "leave threads out", "PROBE": "leave probing out",
    **dict.fromkeys(("TLLFT", "TLRGT", "INDIRV", "GOFWD", "NURBS", "ARCMOV", "MOVARC", "HELIX"),
                    "let the CAM output arcs as CIRCLE/ about z or as GOTO moves"),
    **dict.fromkeys(("TRACUT", "TRANS", "COPY", "ROTATE", "ROTABL", "ROTHED", "PATTERN"), DATUM),
    **dict.fromkeys(("PLUNGE", "SAFETY", "POSTN"), MOVES),
    **dict.fromkeys(("LOOPST", "LOOPND", "MACRO", "CALL", "IF", "JUMPTO", "TERMAC"), MACROS),
}  # fmt: skip
