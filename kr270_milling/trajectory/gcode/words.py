"""The G and M words of milling controllers: what each sets, what is read over, what is refused and with which advice.

Sources: NIST RS274/NGC (Kramer 2000), the LinuxCNC G-code reference, Haas mill programming manual, Fanuc 0i manuals,
Sinumerik 840D ISO and DIN dialects.
"""

from __future__ import annotations

__all__ = [
    "CYCLES", "G_ADVICE", "G_GROUPS", "G_SILENT", "M_ADVICE", "M_GROUPS", "NAMES_ADVICE", "NAMES_SILENT", "OFFSETS",
    "UNKNOWN",
]  # fmt: skip

#: G word -> modal group; two different words of one group cannot stand in one line
G_GROUPS = {0: "motion", 1: "motion", 2: "motion", 3: "motion", 17: "plane", 18: "plane", 19: "plane", 20: "units",
            21: "units", 70: "units", 71: "units", 700: "units", 710: "units", 90: "distance", 91: "distance",
            90.1: "centre", 91.1: "centre", 93: "feed", 94: "feed", 95: "feed", 98: "return", 99: "return", 4: "dwell",
            28: "home", 30: "home", 53: "home", 153: "home", 80: "cycle", 10: "data",
            92: "preset", 52: "shift", 54.1: "offset", 154: "offset"}  # fmt: skip
#: drilling and boring cycles that are expanded
CYCLES = (73, 81, 82, 83, 85, 86, 89)
OFFSETS = {54: "G54", 55: "G55", 56: "G56", 57: "G57", 58: "G58", 59: "G59", 59.1: "G59.1", 59.2: "G59.2",
           59.3: "G59.3"} | {n: f"G{n}" for n in range(505, 600)}  # fmt: skip
G_GROUPS |= dict.fromkeys(OFFSETS, "offset") | dict.fromkeys(CYCLES, "cycle")

#: G words that change no path: cancelled modes, look-ahead, exact stop, the length of the tool
G_SILENT = frozenset({5.1, 8, 9, 15, 40, 43, 49, 50, 50.1, 60, 61, 61.1, 61.2, 62, 63, 64, 67, 69, 69.1, 92.1, 92.2,
                      92.3, 97, 103, 187, 450, 451, 500, 601, 602, 603, 641, 642, 643, 644, 645, 646, 13.1, 54.4,
                      290, 291, 126, 127, 40.1})  # fmt: skip

CENTRE = "let the CAM output the path of the tool's centre (compensation in the computer)"
MACROS = "post without macros and sub-programs, every move in one program"
DATUM = "let the CAM output coordinates of one work offset, without shift, rotation, mirror or scale"
CURVES = "let the CAM output lines and arcs"
THREADS = "leave threads out of this program; they are bound to the spindle's angle"
PROBING = "leave probing out of this program"
AXES5 = "post a 3-axis program: the tool stands along z of the workpiece"
LATHE = "this is a word of lathes; post for a mill"
POCKETS = "let the CAM output the cycle as G1, G2 and G3 moves"
UNKNOWN = "it is not known; post for a 3-axis mill with Fanuc, Haas, LinuxCNC or Sinumerik control"

G_ADVICE = {41: CENTRE, 42: CENTRE, 41.1: CENTRE, 42.1: CENTRE, 141: CENTRE,
            43.4: AXES5, 43.5: AXES5, 68.2: AXES5, 53.1: AXES5, 234: AXES5, 254: AXES5, 255: AXES5, 43.1: AXES5,
            65: MACROS, 66: MACROS, 66.1: MACROS, 22: PROBING, 23: PROBING, 31: PROBING, 36: PROBING, 37: PROBING,
            35: PROBING, 136: PROBING, 38.2: PROBING, 38.3: PROBING, 38.4: PROBING, 38.5: PROBING,
            16: DATUM, 51: DATUM, 51.1: DATUM, 52: DATUM, 68: DATUM, 92: DATUM, 10: DATUM, 110: DATUM, 111: DATUM,
            112: DATUM, 44: DATUM, 100: DATUM, 101: DATUM,
            5: CURVES, 5.2: CURVES, 5.3: CURVES, 6: CURVES, 6.1: CURVES, 6.2: CURVES, 6.3: CURVES,
            2.3: CURVES, 3.3: CURVES, 33: THREADS, 33.1: THREADS,
            74: THREADS, 76: THREADS, 84: THREADS, 84.2: THREADS, 84.3: THREADS,
            88: THREADS, 331: THREADS, 332: THREADS, 96: LATHE, 7: LATHE, 32: LATHE, 72: LATHE, 87: POCKETS,
            12: POCKETS, 13: POCKETS, 150: POCKETS, 34: POCKETS, 47: POCKETS, 107: AXES5,
            12.1: AXES5, 7.1: AXES5}  # fmt: skip

M_GROUPS: dict[float, str] = {
    2: "end", 30: "end", 99: "end", 17: "end", 3: "spindle", 4: "spindle", 5: "spindle", 13: "spindle", 14: "spindle",
    19: "spindle", 6: "tool",
}  # fmt: skip
M_ADVICE: dict[float, str] = {
    98: MACROS, 97: MACROS, 96: MACROS, 72: MACROS, 198: MACROS, 128: AXES5, 129: AXES5, 29: THREADS,
}  # fmt: skip


HEIDENHAIN = "a program of a Heidenhain control; post it as ISO (DIN) G-code"


def _each(names: str, advice: str) -> dict[str, str]:
    return dict.fromkeys(names.split(), advice)


#: words that change no path: dynamics, compressors, orientation of nothing, messages, modes that end
NAMES_SILENT = frozenset(
    _each(
        """DIAMOF DIAMON DIAM90 FFWON FFWOF SOFT BRISK DRIVE COMPOF COMPON COMPCAD COMPCURV COMPSURF CFTCP CFC CFIN
        TRAFOOF STOPRE UPATH SPATH KONT KONTC KONTT NORM CUT2D WORKPIECE CYCLE832 MSG GROUP_BEGIN GROUP_END GROUP_ADDEND
        DYNNORM DYNFINISH DYNROUGH DYNSEMIFIN DYNPOS DYNPREC PROC SETMS SPOS ADIS ADISPOS FGROUP FNORM FLIN ORIWKS
        ORIMKS ORIAXES DISPLOF SAVE ACC OVR SPCON SPCOF FRESH CTOL OTOL STOLF LIMS VELOLIM JERKLIM ACCLIM""",
        "",
    )
)
NAMES_ADVICE = {
    **_each(
        """IF ENDIF ELSE WHILE ENDWHILE END GOTO GOTOF GOTOB FOR ENDFOR DO REPEAT CALL EXTCALL DEF SUB EQ NE LOOP
        ENDLOOP CASE SETVN DEFINE UNTIL RETURN EXTERN ENDSUB ENDREPEAT ELSEIF BREAK CONTINUE THEN""",
        MACROS,
    ),
    **_each("TRANS ATRANS ROT AROT ROTS AROTS SCALE ASCALE MIRROR AMIRROR", DATUM),
    **_each("BSPLINE CSPLINE ASPLINE POLY CIP CT INVCW INVCCW RND RNDM CHF CHR ANG", CURVES),
    **_each("TRAORI CYCLE800 TRANSMIT TRACYL TCARR PAROT TOROT", AXES5),
    **_each("CYCLE84 CYCLE840 CYCLE70", THREADS),
    **_each(
        """MCALL CYCLE81 CYCLE82 CYCLE83 CYCLE85 CYCLE86 CYCLE89 POCKET3 POCKET4 CYCLE61 CYCLE62 CYCLE63 CYCLE64 CYCLE71
        CYCLE72 CYCLE76 CYCLE77 CYCLE79 CYCLE899 SLOT1 SLOT2 HOLES1 HOLES2 LONGHOLE""",
        POCKETS,
    ),
    **_each("MEAS MEAW CYCLE977 CYCLE978 CYCLE998", PROBING),
    **_each("BEGIN PGM", HEIDENHAIN),
}
