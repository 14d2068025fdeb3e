"""The G and M words of milling controllers: what each sets, what is read over, what is refused and with which advice.

Sources: NIST RS274/NGC (Kramer 2000), the LinuxCNC G-code reference, Haas mill programming manual, Fanuc 0i manuals,
Sinumerik 840D ISO and DIN dialects.
"""

from __future__ import annotations

from kr270_milling.path.cam.machine import INCH, MM

#: modal state of a machine -> the G words that set it, and their values
MODAL: dict[str, dict[float, object]] = {
    "unit": {20: INCH, 70: INCH, 700: INCH, 21: MM, 71: MM, 710: MM},
    "incremental": {90: False, 91: True},
    "absolute_centre": {90.1: True, 91.1: False},
    "plane": {17: 17, 18: 18, 19: 19},
    "to_initial": {98: True, 99: False},
}
#: work offsets: 110 to 129 of Haas, 500 is the machine's own zero on Sinumerik
OFFSETS = {n: f"G{n:g}" for n in (54, 55, 56, 57, 58, 59, 59.1, 59.2, 59.3, *range(110, 130), *range(500, 600))}
#: G words that change no path -> the letters that belong to them: cancelled modes, look-ahead, exact stop, the
#: tool length, limits. 5, 74 and 75 change none together with some other words.
SILENT_G: dict[float, str] = {
    **dict.fromkeys(
        (28.1, 30.1, 9, 13.1, 15, 40.1, 49, 60, 61, 61.2, 62, 67, 69, 69.1, 74, 75, 92.1, 92.2, 92.3, 97), ""
    ),
    **dict.fromkeys((290, 291, 450, 451, *range(601, 604), *range(641, 647)), ""),
    **dict.fromkeys((5, 8, 54.4, 61.1, 103), "P"),
    **dict.fromkeys((25, 26), "XYZS"),  # working area, least and largest speed
    **dict.fromkeys((5.1, 64), "PQR"),
    43: "H",
    43.1: "Z",
    50: "S",
    50.1: "XYZ",
    187: "PE",
}
#: M words that change no path -> the letters that belong to them: stops, coolant, clamps, gears, conveyors, doors,
#: outputs, overrides (ISO 6983-1, Haas, LinuxCNC, Sinumerik)
SILENT_M: dict[float, str] = {
    **dict.fromkeys((0, 1, 7, 8, 9, 10, 11, 12, 18, *range(20, 29), *range(31, 46), 48, 49, *range(54, 59)), ""),
    **dict.fromkeys((60, *range(76, 90), *range(104, 120), 126, 127, 138, 139, 158, 159, 160, 161), ""),
    **dict.fromkeys((49, 50, 51, 52, 53, 59, 62, 63, 64, 65, 69, 109), "P"),
    **dict.fromkeys((67, 68), "EQ"),
    19: "RPQ",
    66: "PLEQ",
    106: "PS",
}
#: G word -> modal group; two different words of one group are not allowed in one line. Each silent word is a group.
G_GROUPS: dict[float, str] = {
    **{n: f"G{n:g}" for n in SILENT_G},
    **{word: name for name, words in MODAL.items() for word in words},
    **dict.fromkeys((0, 1, 2, 3, 5.2, 5.3, 6.2), "motion"),
    **dict.fromkeys(
        (73, 76, 80, 81, 82, 83, 85, 86, 89), "cycle"
    ),  # drilling and boring cycles, expanded; 80: their end
    **dict.fromkeys((93, 94, 95), "feed"),
    **dict.fromkeys((28, 30, 53, 153), "home"),
    **dict.fromkeys((*OFFSETS, 54.1, 154), "offset"),
    4: "dwell",
    16: "polar",
    72: "holes",
    65: "call",
    10: "data",
    52: "shift",
    68: "turn",
    68.2: "tilt",
    **dict.fromkeys((53.1, 53.6), "orient"),
    **dict.fromkeys((43.4, 43.5, 234), "tip"),
    92: "preset",
    **dict.fromkeys((40, 41, 41.1, 42, 42.1), "compensation"),
}
M_GROUPS: dict[float, str] = {
    **{n: f"M{n:g}" for n in SILENT_M},
    **dict.fromkeys((2, 30, 99, 17, 47), "end"),  # 47: from the first line again (Mach3)
    **dict.fromkeys((97, 98), "call"),
    **dict.fromkeys((70, 71, 72, 73), "modes"),
    **dict.fromkeys((3, 4, 5, 13, 14, 19), "spindle"),
    **dict.fromkeys((6, 61), "tool"),
    **dict.fromkeys((128, 129), "tip"),
}
#: G words that own these letters on some controls and not on others -> letters, what they mean there; with G0 to G3 in
#: the line they are a move
CLAIMS: dict[float, tuple[str, str]] = {
    **dict.fromkeys((58, 59), ("XYZ", "shifts the zero on Sinumerik and moves the tool elsewhere")),
    **dict.fromkeys((110, 111, 112), ("XYZ", "is a pole on Sinumerik and a work offset of Haas")),
    **dict.fromkeys((70, 71), ("IJKLPQ", "is a circle of holes on Haas, a cycle of lathes and a unit elsewhere")),
    50: ("XYZ", "sets coordinates on some controls and ends a scale on others"),
    60: ("XYZ", "is a rapid move on Fanuc and an exact stop on Sinumerik"),
}

MACROS = "post without macros and sub-programs, every move in one program"
DATUM = "let the CAM output coordinates of one work offset, without shift, rotation, mirror or scale"
CURVES = "let the CAM output lines and arcs"
PROBING = "leave probing out of this program"
AXES5 = "post tilted planes with G68.2 or CYCLE800, or a 3-axis program"
POCKETS = "let the CAM output the cycle as G1, G2 and G3 moves"
UNKNOWN = "it is not known; post for a 3-axis mill with Fanuc, Haas, LinuxCNC or Sinumerik control"


HEIDENHAIN = "a program of a Heidenhain control; give its file the ending .h"


def word_of(letter: str, value: float) -> str:
    """Return a word as the program writes it: its number may be a name, and a name keeps all digits."""
    return letter + repr(float(value)).removesuffix(".0")


def _each(names: str, advice: str) -> dict[str, str]:
    return dict.fromkeys(names.split(), advice)


#: words that cannot be run -> what to do
ADVICE = {
    **_each("G141", "let the CAM output the path of the tool's centre (compensation in the computer)"),
    **_each("G66 G66.1 M96 M198", MACROS),
    **_each(
        """IF ENDIF ELSE WHILE ENDWHILE END GOTO GOTOF GOTOB FOR ENDFOR DO REPEAT CALL EXTCALL DEF SUB EQ NE LOOP
        ENDLOOP CASE SETVN DEFINE UNTIL RETURN EXTERN ENDSUB ENDREPEAT ELSEIF BREAK CONTINUE THEN""",
        MACROS,
    ),
    **_each("G51 G51.1 G44 G100 G101 DIAMON DIAM90", DATUM),
    **_each("TRANS ATRANS ROT AROT ROTS AROTS SCALE ASCALE MIRROR AMIRROR", DATUM),
    **_each("G6 G6.1 G6.3 G2.3 G3.3", CURVES),
    **_each("BSPLINE CSPLINE ASPLINE POLY CIP CT INVCW INVCCW RND RNDM CHF CHR ANG", CURVES),
    **_each("G68.3 G68.4 G254 G255 G107 G12.1 G7.1", AXES5),
    **_each("TRANSMIT TRACYL TCARR PAROT TOROT", AXES5),
    **_each(
        "G33 G33.1 G74 G84 G84.2 G84.3 G63 G331 G332 M29 CYCLE84 CYCLE840 CYCLE70",
        "leave threads out of this program; they are bound to the spindle's angle",
    ),
    **_each("G96 G7 G32 G71.1 G71.2 G72.1 G72.2", "this is a word of lathes; post for a mill"),
    **_each("G88", "the tool is withdrawn by hand; write G86 or G89"),
    **_each("G87 G12 G13 G150 G34 G47", POCKETS),
    **_each(
        """MCALL CYCLE81 CYCLE82 CYCLE83 CYCLE85 CYCLE86 CYCLE89 POCKET3 POCKET4 CYCLE61 CYCLE62 CYCLE63 CYCLE64 CYCLE71
        CYCLE72 CYCLE76 CYCLE77 CYCLE79 CYCLE899 SLOT1 SLOT2 HOLES1 HOLES2 LONGHOLE""",
        POCKETS,
    ),
    **_each("G22 G23 G31 G36 G37 G35 G136 G38.2 G38.3 G38.4 G38.5", PROBING),
    **_each("MEAS MEAW CYCLE977 CYCLE978 CYCLE998", PROBING),
    **_each("BEGIN PGM M91 M92 M136 M140", HEIDENHAIN),
    **_each("FLIN OVR FGROUP FB FZ FD", "let the CAM output each feed as F"),
}
#: letters that no word of their line takes -> what to do
LEFT = {
    **dict.fromkeys("LPO", "a jump or a call; " + MACROS),
    **dict.fromkeys("ABC", f"state the machine of the program as machine.kinematics in the cell, or {AXES5}"),
    **dict.fromkeys("UVW", AXES5),
    "E": "a word of 3-D printers; post for a milling machine",
}
#: names that change no path: dynamics, compressors, orientation of nothing, messages, modes that end
SILENT = frozenset(
    _each(
        """DIAMOF FFWON FFWOF SOFT BRISK DRIVE COMPOF COMPON COMPCAD COMPCURV COMPSURF CFTCP CFC CFIN
        TRAFOOF STOPRE UPATH SPATH KONT KONTC KONTT NORM CUT2D WORKPIECE CYCLE832 MSG GROUP_BEGIN GROUP_END GROUP_ADDEND
        DYNNORM DYNFINISH DYNROUGH DYNSEMIFIN DYNPOS DYNPREC PROC SETMS SPOS ADIS ADISPOS FNORM ORIWKS
        ORIMKS ORIVECT ORIAXES DISPLOF SAVE ACC SPCON SPCOF FRESH CTOL OTOL STOLF LIMS VELOLIM JERKLIM ACCLIM""",
        "",
    )
)
