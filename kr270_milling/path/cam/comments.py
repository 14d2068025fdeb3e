"""What comments of posts say: names of operations, and tools with their diameters and teeth."""

from __future__ import annotations

import re

from kr270_milling.path.source_program import ProgramTool

__all__ = ["ABOUT_TOOL", "AXIAL_KINDS", "described_tool", "kind_of", "operation_name"]

NUMBER = r"((?<![0-9])[0-9]+(?:\.[0-9]*)?|\.[0-9]+)"  # one start and one end in a row of digits
#: lines by which posts announce an operation: FreeCAD, OpenBuilds, Vectric, Estlcam, CATIA
ANNOUNCED = re.compile(
    r"(?:begin operation|toolpath ?(?:name)?|operation(?: \d+ of \d+| name)?|op(?: ?\d+)?)\s*[:=]-?\s*(\S.*)",
    re.I,
)
NAME = re.compile(r"[^\W_][\w .,/+#&'-]*(?:\([\w ]*\))?[\w .]*")
#: comments that look like names: what begins and ends, hints to the operator, notes of a post
NO_NAME = re.compile(
    r"(?:begin|end|start|finish operation|stop|block|path|exported|post|output|file|date|time|compensated|"
    r"machine|vendor|model|description|document|setup|units?|material|program|made|generated|created|msg|debug|"
    r"print|when using|moves|rapid moves|using|tools?|toolchange\w*|t\d+|tc|set|safe|spindle|coolant|work|stock|www|"
    r"http|default tool|feature|n/?a|no|mm|inch|x|y|z|wcs|total|this|return|go|move|retract|penetrate|header|"
    r"footer)\b",
    re.I,
)
#: what happens inside an operation
INSIDE = re.compile(
    r"(?:(?:helical|helix|spiral|linear|zig-?zag|profile)\s+(?:ramp(?:ing)?|entry|exit|plunge|motion|lead)"
    r"|ramp(?:ing)?|lead[- ]?(?:in|out)|plunge|link(?:ing)?|transition|(?:depth|level|layer|pass)\s*\d*)"
    r"(?:\s+(?:in|out|down|move|motion|\d+))*",
    re.I,
)
LONGEST_NAME = 48
MOST_WORDS = 7

TOOL_NUMBER = re.compile(r"\s*(?:tool\s*[-#:]?\s*|t\s*)0*(\d+)\b", re.I)
ANY_NUMBER = re.compile(r"\bT0*(\d+)\b", re.I)
NO_TOOL = re.compile(r"\s*(?:stock|material|block|wcs|part)\b", re.I)
SAYS_DIAMETER = re.compile(r"\bdia", re.I)
OLD_MASTERCAM = re.compile(r"(.*?)TOOL\s*-\s*0*(\d+)\s+DIA\. OFF", re.I)
DIAMETER = re.compile(
    rf"(?:tool dia\.?|\bdiam(?:eter)?|\bdia\.?|\bd|ø)\s*[-=:.]?\s*{NUMBER}(?![\d/])\s*(mm|in|inch|\")?(?!\s*\. off)",
    re.I,
)
BEFORE = re.compile(rf"{NUMBER}\s*dia(?:m|meter)?\b", re.I)
METRIC = re.compile(rf"{NUMBER}\s*mm\b", re.I)
FRACTION = re.compile(r"(?<![\w.])(?:(\d+)[- ])?(\d+)/(\d+)\s*(?:\"|in|inch|''|flat|ball|end|\s|$)", re.I)
INCH_MARK = re.compile(rf"{NUMBER}\s*(?:\"|''|in\b|inch)", re.I)
#: radius of a corner: CR=1, R0.5, D10R2, RAD. 2., Eckenradius 0.5; and 0.5 CR
CORNER = re.compile(rf"(?:\b(?:CR|(?:eck(?:en)?)?rad(?:ius)?)|(?<![^\W\d_])R)\.?\s*[-=:]?\s*{NUMBER}", re.I)
CORNER_BEFORE = re.compile(rf"{NUMBER}\s*(?:mm|in|\")?\s*(?:CR|corner rad(?:ius)?)\b", re.I)
DECIMAL_COMMA = re.compile(r"(?<=\d),(?=\d)")
TEETH = re.compile(r"(?:(?<!\d)(\d+)\s*-?\s*(?:flutes?|flt|fl|teeth)\b|\bz\s*=\s*(\d+)\b|\b(\d+)f\b)", re.I)
#: comment that is about a tool as a whole, without its number: FreeCAD, Vectric, Estlcam
ABOUT_TOOL = re.compile(r"\s*(?:TC|tool|werkzeug|wz|cutter|bit)\b\s*[:=]", re.I)
KIND = re.compile(
    r"(?:flat|square|ball|bull|nose|face|chamfer|shell|slot|spot|cent(?:er|re)|twist|rough\w*|thread\w*|carbide|taper\w*"
    r"|t-?slot|key\w*|woodruff|engraving|corner|round\w*|radius|form|high|feed|step|conical|\s|-)*"
    r"(?:end ?mills?|mill|ball ?nose|bull ?nose|drill|tap|reamer|probe|cutter|engraver|v-?bit|bit|face ?mill|lollipop"
    r"|fly ?cutter|dove ?tail|boring (?:bar|head)|slitting saw|\w*fr\S{1,3}ser|\w*bohrer|\w*senker|reibahle|\w*stichel"
    r")\b",
    re.I,
)
FLAT_KINDS = re.compile(
    r"\b(?:flat|square)[- ]*(?:nose[- ]*)?(?:end)?[- ]?mill|(?<!feed )(?<!insert )(?:face|shell)[- ]?mill"
    r"|fly ?cutter|slot ?drill"
    r"|(?<!t-)(?<!t)(?:schaft|plan|eck|walzenstirn|schrupp|schlicht|finger|langloch|bohrnuten|nuten)fr\S{1,3}ser",
    re.I,
)
#: kind of a tool that is no flat end mill -> its words, as posts write them. The words of the Fusion, Mastercam and
#: SolidCAM tool libraries, of FreeCAD, Vectric and Estlcam, and the German ones; the first kind that fits is the kind
OTHER_KINDS = {
    kind: re.compile(words, re.I)
    for kind, words in {
        "tap": r"\btap\b|\btaps\b|gewinde(?:bohr|form)|(?:right|left) hand tap|\btaraud",
        "thread mill": r"\bthread|\bth[rd][- ]?mill|gewindefr",
        "countersink": r"counter ?sink|\bc'?sink|\bcsk|(?<!flach)senker",
        "counterbore": r"counter ?bore|flachsenker",
        "spot drill": r"\bspot|anbohrer",
        "centre drill": r"\bcent(?:er|re)[- ]?drill|zentrier",
        "reamer": r"\bream|reibahle",
        "boring bar": r"\bbor(?:e|ing)[- ]?(?:bar|head)|ausdreh|bohrstange|feinbohr",
        "drill": r"(?<!slot )\bdrill|spade ?drill|bohrer|\bforet|\bbroca",
        "ball-end mill": r"\bball|spher|sferic|kugel|vollradius|kopierfr|\bcopy[- ]?mill|core ?box|hemi"
        r"|\bboule|\bbn(?:em)?(?:\d|\b)",
        "lollipop cutter": r"lolli",
        "dovetail cutter": r"\bdove|schwalben",
        "T-slot cutter": r"\bt[- ]?slot|\bt[- ]?nut|\bslot[- ]?mill|key[- ]?(?:seat|(?:way|slot)?[- ]?(?:cutter|mill))"
        r"|woodruff|slitting|\bsaw\b|side and face|\bdis[ck][- ]?mill|scheibenfr|kreiss.{1,2}ge|s.{1,2}geblatt"
        r"|under ?cut|hinterschn",
        "high-feed mill": r"high[- ]?feed|\bhfc\b|hochvorschub|feed[- ]?mill",
        "chamfer mill": r"chamf|chanfr|\bcham\b|\bfas(?:e|fr|\b)|(?:winkel|prismen)fr|entgrat|deburr|bevel",
        "engraver": r"engrav|grav(?:i|eur)|stichel|diamond drag|\bv(?:ee)?[- ]?(?:bit|carv\w*|cutter|groove|tool)\b"
        r"|\bdrag ?(?:knife|bit)",
        "corner-rounding cutter": r"corner[- ]?round|round[- ]?over|quarter[- ]?round|radius[- ]?mill"
        r"|fillet[- ]?(?:mill|cutter)|\bogee|viertelkreis|radi(?:us|en)fr",
        "form mill": r"\bform[- ]?(?:mill|tool|cutter|fr)|formfr|\bbarrel|\blens\b|circle segment|kreissegment|tonnenfr"
        r"|step[- ]?mill",
        "bull-nose mill": r"\bbull|\btor(?:us|oid|i[cqs])|rundplatten|\bbutton|round insert",
        "tapered mill": r"\btaper|konisch|kegel|\bconi[cq]|\bcone",
        "probe": r"\bprobe|taster|edge ?finder",
        "brush or abrasive tool": r"\bbrush|b.{1,2}rste\b|\bgrinding|schleif|\bburr\b|polier|burnish",
    }.items()
}
OPERATIONS = frozenset(("drill", "tap", "probe"))  #: names of operations and of tools
#: kinds of tools that are not judged as mills while they go along their axis only
AXIAL_KINDS = frozenset(
    ("tap", "countersink", "counterbore", "spot drill", "centre drill", "reamer", "boring bar", "drill")
)
TAPER_ANGLE = re.compile(r"\bTAPER=", re.I)  #: of a chamfer mill or of the point of a drill


def kind_of(words: str) -> str:
    """Return the kind of the tool that words name; "" for a flat end mill and where they name no kind."""
    words = TAPER_ANGLE.sub("", words.replace("_", " "))
    if FLAT_KINDS.search(words):
        return ""
    return next((kind for kind, pattern in OTHER_KINDS.items() if pattern.search(words)), "")


def operation_name(comment: str) -> tuple[str, bool]:
    """The name of an operation that a comment gives, and whether it says that it is one; "" for other comments."""
    announced = ANNOUNCED.fullmatch(comment)
    if announced and re.search(r"[^\W\d_]", announced.group(1)):
        return announced.group(1).strip()[:LONGEST_NAME], True
    if len(comment) > LONGEST_NAME or len(comment.split()) > MOST_WORDS or not NAME.fullmatch(comment):
        return "", False
    if INSIDE.fullmatch(comment):
        return "", False
    if not re.search(r"[^\W\d_]{2}", comment) or NO_NAME.match(comment) or comment.endswith((".", ",")):
        return "", False
    tool = described_tool(comment, 1e-3, "")
    if tool is not None and (tool.teeth or (tool.diameter and tool.description)):
        return "", False
    return comment, False


def described_tool(comment: str, unit: float, changed: str | None = None, beside: bool = False) -> ProgramTool | None:
    """The tool that a comment describes; lengths without a unit are in ``unit`` [m]; changed: the tool of its line.

    beside: the comment is in the line of the change. Of a comment without a tool number, which may name an operation
    (drill, chamfer), only the name of a tool counts (twist drill, chamfer mill).
    """
    if NO_TOOL.match(comment):
        return None
    comment = DECIMAL_COMMA.sub(".", comment)
    old = OLD_MASTERCAM.match(comment)
    numbered = TOOL_NUMBER.match(comment)
    inside = ANY_NUMBER.search(comment)
    number = next((match.group(k) for match, k in ((old, 2), (numbered, 1), (inside, 1)) if match), "")
    name = f"T{int(number)}" if number else changed
    diameter = _diameter(comment, unit)
    teeth = TEETH.search(comment)
    phrase = KIND.search(comment)
    words = " ".join(phrase.group().split()).lower().strip("- ") if phrase else ""
    about_tool = bool(number or beside or ABOUT_TOOL.match(comment))
    kind = kind_of(comment if about_tool else words if words not in OPERATIONS else "")
    if name is None or not (words or kind or teeth or (diameter and (number or SAYS_DIAMETER.search(comment)))):
        return None
    count = int(next(filter(None, teeth.groups()))) if teeth else 0
    corner = CORNER.search(comment) or CORNER_BEFORE.search(comment)
    radius = float(corner.group(1)) * unit if corner else 0.0
    if radius > 0.51 * diameter > 0.0:  # a number of another thing, as R8 of a collet
        radius = 0.0
    return ProgramTool(name, words, diameter, count if 1 <= count <= 20 else 0, corner_radius=radius, kind=kind)


def _diameter(comment: str, unit: float) -> float:
    """[m]; 0 where the comment gives none, or a number that is no diameter of a cutter."""
    comment = comment.split("- ZMIN")[0]
    comment = re.sub(r"\|\s*[HD]\s*\d+\s*(?=\||$)", "|", comment)  # offset numbers of Mastercam
    comment = re.sub(r"DIA\. OFF\.\s*-\s*\d+", "", comment)
    diameter = 0.0
    if given := list(DIAMETER.finditer(comment)):
        number, mark = given[-1].groups()
        scale = {"mm": 1e-3, "in": 0.0254, "inch": 0.0254, '"': 0.0254}.get((mark or "").lower(), unit)
        diameter = float(number) * scale
    elif before := BEFORE.search(comment):
        diameter = float(before.group(1)) * unit
    elif metric := METRIC.search(comment):
        diameter = float(metric.group(1)) * 1e-3
    elif fraction := FRACTION.search(comment):
        whole, above, below = fraction.groups()
        diameter = (int(whole or 0) + int(above) / max(int(below), 1)) * 0.0254
    elif inches := INCH_MARK.search(comment):
        diameter = float(inches.group(1)) * 0.0254
    return diameter if 1e-5 < diameter <= 0.2 else 0.0
