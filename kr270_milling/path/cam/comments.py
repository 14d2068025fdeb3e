"""Information in the comments of posts: names of operations, and tools with their diameters and teeth."""

from __future__ import annotations

import re

from kr270_milling.path.source_program import ProgramTool

NUMBER = r"((?<![0-9])[0-9]+(?:\.[0-9]*)?|\.[0-9]+)"  # one start and one end in a row of digits
LONGEST = 300  #: characters of a comment on a tool; the patterns below take the square of the length
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
#: steps inside an operation
INSIDE = re.compile(
    r"(?:(?:helical|helix|spiral|linear|zig-?zag|profile)\s+(?:ramp(?:ing)?|entry|exit|plunge|motion|lead)"
    r"|ramp(?:ing)?|lead[- ]?(?:in|out)|plunge|link(?:ing)?|transition|(?:depth|level|layer|pass)\s*\d*)"
    r"(?:\s+(?:in|out|down|move|motion|\d+))*",
    re.I,
)

TOOL_WORD = r"(?:tool|werkzeug|wkzg?|wz|outil|utensile|herramienta)"
FRACTION = re.compile(r"(?<![\w.])(?:(\d+)[- ])?(\d+)/(\d+)\s*(?:\"|in|inch|''|flat|ball|end|\s|$)", re.I)
DIAMETER = re.compile(
    rf"(?:tool dia\.?|\bdiam(?:eter)?|\bdia\.?|\bd|ø)\s*[-=:.]?\s*{NUMBER}"
    r"(?![\d/]|\.\d|\s*(?:CR|R|rad\w*)\b(?!\s*[=\d.]))\s*(mm|in|inch|\")?(?!\s*\. off)",
    re.I,
)
#: radius of a corner: CR=1, R0.5, D10R2, RAD. 2., Eckenradius 0.5; and 0.5 CR
CORNER = re.compile(rf"(?:\b(?:CR|(?:eck(?:en)?)?rad(?:ius)?)|(?<![^\W\d_])R)\.?\s*[-=:]?\s*{NUMBER}", re.I)
TEETH = re.compile(r"(?:(?<!\d)(\d+)\s*-?\s*(?:flutes?|flt|fl|teeth)\b|\bz\s*=\s*(\d+)\b|\b(\d+)f\b)", re.I)
#: comment that is about a tool as a whole, without its number: FreeCAD, Vectric, Estlcam, TOOL DESC: and TOOL NAME;
#: or a size and the shape alone: 1/4 BALL
ABOUT_TOOL = re.compile(
    rf"\s*(?:TC|{TOOL_WORD}|cutter|bit)\b[ _-]*(?:(?:desc\w*|name|type?|comment|info|bezeichnung)\b\s*[-:=]?|[:=])"
    rf"|\s*(?:[dø]\s*)?(?:\d+/\d+|{NUMBER})\s*(?:mm|in|\")?\s+(?:taper\w* )?"
    r"(?:ball|bull|kugel|t-?slot|dovetail|lollipop|taper)\s*(?:nose|end|tool|[rlz]?\d[\w.]*|\s)*\Z",
    re.I,
)
#: parts of a comment that are about something else: the holder, a side that is no cone, and after the name of an end
#: mill what the mill is for or comes before
ASIDE = re.compile(
    r"(?:\b(?:in|the|taper|R8|(?:BT|CAT|ER|HSK|ISO|NT|SK)[- ]?\d+\w?)\s+)*\b(?:holder|collet|chuck|arbor|spannzange)\b"
    r"(?:\s+(?:taper|(?:BT|CAT|ER|HSK|ISO|NT|SK)[- ]?\d+\w?)\b)*"
    r"|\b0(?:\.0*)?\s*deg\w*\s*taper"
    r"|(?<=mill)(?P<size>[^-(]*?)\b(?:for|before|f(?:ü|ue)r|vor)\s.*",
    re.I,
)
KIND = re.compile(
    r"(?:flat|square|ball|bull|nose|face|chamfer|shell|slot|spot|cent(?:er|re)|twist|rough\w*|thread\w*|carbide|taper\w*"
    r"|t-?slot|key\w*|woodruff|engraving|corner|round\w*|radius|form|high|feed|step|conical|\s|-)*"
    r"(?:end ?mills?|mill|ball ?nose|bull ?nose|drill|tap|reamer|probe|cutter|engraver|v-?bit|bit|face ?mill|lollipop"
    r"|fly ?cutter|dove ?tail|boring (?:bar|head)|slitting saw|\w*fr\S{1,3}ser|\w*bohrer|\w*senker|reibahle|\w*stichel"
    r")\b|\b(?:fraise|fresa|fr\.|foret|broca|punta|taraud|maschio|macho)(?:\s+(?:[aà]|per|de|da|en)\b)?\s+[^\W\d_]+",
    re.I,
)
FLAT_KINDS = re.compile(
    r"\b(?:flat|square)[- ]*(?:nose[- ]*)?(?:end)?[- ]?mill|(?<!feed )(?<!insert )(?:face|shell)[- ]?mill"
    r"|fly ?cutter|slot ?drill"
    r"|(?<!t-)(?<!t)(?:schaft|plan|eck|walzenstirn|schrupp|schlicht|finger|langloch|bohrnuten|nuten)fr\S{1,3}ser"
    r"(?![- ]*t\b)",
    re.I,
)
#: a mill for faces with a conical side: 45 DEG, KAPR 45; 90 deg is a shoulder, and an angle of the helix is none
CONICAL_FACE = re.compile(
    r"(?=.*(?:face|plan|surfac))(?=.*(?:(?<![\d.])(?!90|0)\d\d(?:\.\d*)?\s*(?:deg|°|grad)(?!\w*\s*(?:helix|drall))"
    r"|\b(?:kapr|kappa|einstellwinkel)\s*[=:]?\s*(?!90)\d))",
    re.I,
)
#: kind of a tool that is no flat end mill -> its words, as posts write them. The words of the Fusion, Mastercam and
#: SolidCAM tool libraries, of FreeCAD, Vectric and Estlcam, and the German, Italian, French and Spanish ones; the first
#: kind that fits is the kind
OTHER_KINDS = {
    kind: re.compile(words, re.I)
    for kind, words in {
        "tap": r"\btap\b|\btaps\b|gewinde(?:bohr|form)|(?:right|left) hand tap|\btaraud"
        r"|\bmaschi[oa]|\bmacho|\w+tap\b|\bgew\w*\.\s*bohr",
        "thread mill": r"\bthread|\bthr?d?[- ]?mill|gewinde(?:fr|wirb)|filet(?:er|age|t)|\brosca|\bsptm\b|\bgf\s*m\d",
        "countersink": r"counter ?sink|\bc'?sink|\bcsk|(?<!flach)senker|\bsvasa|\bfrais(?:ur|oir)"
        r"|\bavellan",
        "counterbore": r"counter ?bore|flachsenker",
        "spot drill": r"\bspot|anbohrer",
        "centre drill": r"\bcent(?:er|re)[- ]?drill|zentrier|\bpoint(?:er|eur)|\bcentra(?:r|tore)\b"
        r"|\bda centro",
        "reamer": r"\bream|reibahle|\bal[eé]s[ao]|\bescaria|\brmr\b",
        "boring bar": r"\bbor(?:e|ing)[- ]?(?:bar|head)|ausdreh|ausspindel|bohrstange|feinbohr"
        r"|\bbare?no\b|\bbarre\b|fine ?bore",
        "drill": r"(?<!slot )\bdrill|spade ?drill|bohrer|\bforet|\bbroca|\bjobber|\btwist\b|\bspade\b"
        r"|(?<!fresa )\bpunta\b(?! (?:de bola|sferica|tonda))",
        "tapered ball-end mill": r"(?=.*(?:\btaper|konisch|kegel|\bconi[cq]))(?=.*(?:\bball|spher|sferic|kugel)).",
        "ball-end mill": r"\bball|spher|sferic|kugel|vollradius|kopierfr|\bcopy[- ]?mill|core ?box|hemi"
        r"|\bboule|\bbola\b|\bb(?:n|em|nem)(?:\d|\b)|full[- ]?rad|\bpunta tonda",
        "lollipop cutter": r"loll[iy]",
        "dovetail cutter": r"\bdove|schwalben|coda di rondine|aronde|cola de milano",
        "T-slot cutter": r"\bt[- ]?slot|\bt[- ]?nut|nut\w*fr\S{1,3}ser[- ]*t\b"
        r"|\bfresa a t\b|\ben t\b|\bslot[- ]?mill|key[- ]?(?:seat|(?:way|slot)?[- ]?(?:cutter|mill))"
        r"|woodruff|slit(?:ting|saw)|\bsaw\b|side and face|\bdis[ck][- ]?mill|scheibenfr|kreiss.{1,2}ge|s.{1,2}geblatt"
        r"|\bs(?:ä|ae)ge"
        r"|under ?cut|hinterschn|\bscie\b|\ba disco",
        "high-feed mill": r"hi(?:gh)?[- ]?feed|\bhf[cm]\b|hochvorschub|feed[- ]?mill",
        "chamfer mill": r"chamf|chanfr|chafl|\bchmf|smuss|\bcham\b"
        r"|\bfas(?:e|fr|\b)|(?:winkel|prismen)fr|entgrat|deburr|bevel",
        "engraver": r"engrav|grav(?:i|eur)|stichel|diamond drag|\bv(?:ee)?[- ]?(?:bit|carv\w*|cutter|groove|tool)\b"
        r"|\bdrag ?(?:knife|bit)|\bv-?[1-9]\d\d?\b|\d\s*(?:deg\w*|°|grad)\s*v\b|\ba v\b|\bjavelot|\bpyramid|\bbulino",
        "corner-rounding cutter": r"corner[- ]?round|round[- ]?over|quarter[- ]?round|radius[- ]?mill"
        r"|fillet[- ]?(?:mill|cutter)|\bogee|viertel(?:kreis|rund)|radi(?:us|en)fr",
        "form mill": r"\bform[- ]?(?:mill|tool|cutter|fr)|formfr|\bbarrel|\blens\b|circle segment|kreissegment|tonnenfr"
        r"|step[- ]?mill",
        "bull-nose mill": r"\bbull|\btor(?:us|oid|i[cqs])|\braggiat|rundplatten|\bbutton|round insert",
        "tapered mill": r"\btaper|konisch|kegel|\bconi[cq]|\bcone",
        "probe": r"\bprobe|taster|renishaw|edge ?finder",
        "brush or abrasive tool": r"\bbrush|b.{1,2}rste\b|\bgrinding|schleif|\bburr\b|polier|burnish",
    }.items()
}
#: name of a mill, and the parts of names that a flat one has; any other part names another kind: PROFILE CUTTER
MILL = re.compile(r"([^\W\d_]+)[- ](?:cutter|mill)\b|([^\W\d_]+?)-?fr(?:\W|ä|ae|a)ser", re.I)
OF_FLAT = re.compile(
    r"(?:flat|square|end|face|facing|shell|shoulder|fly|rough\w*|finish\w*|hog\w*|plunge|insert\w*|index\w*|helical"
    r"|spiral|(?:up|down)(?:cut)?|cut(?:ting)?|compression|flutes?|fl|teeth|mm|in|inch|solid|carbide|cobalt|hss?e?|hm|vhm"
    r"|hp[cm]|hs[cm]|steel|alu\w*|metal|wood|long|short|stub|reach|large|small|big|new|old|use|tool|cnc|nc|the|a|or|and"
    r"|\w*(?:schaft|plan|eck|stirn|walzen|schrupp|schlicht|finger|langloch|nuten|igel|schneid\w*|zahn|platten|wsp))",
    re.I,
)
#: kinds of tools that are not judged as mills while they go along their axis only; a tap needs the angle of the spindle
AXIAL_KINDS = frozenset(("countersink", "counterbore", "spot drill", "centre drill", "reamer", "boring bar", "drill"))
#: cutters with inserts in a body, and faces are milled with such cutters
INSERTS = re.compile(
    r"insert|\bindex|\bshell|\bfac(?:e|ing)|platte|\bwsp|messerkopf|(?:plan|eck|igel|walzenstirn)fr|coromill|plaquette|surfac",
    re.I,
)


def kind_of(words: str) -> str:
    """Return the kind of the tool that words name; "" for a flat end mill and where they name no kind.

    A mill with a name that is in no list is a kind.
    """
    words = words[:LONGEST].replace("_", " ")
    words = re.sub(r"\bTAPER=", "", words, flags=re.I)  # the angle of a chamfer mill or of a drill
    if CONICAL_FACE.match(words):
        return "tapered mill"
    if FLAT_KINDS.search(words):
        return ""
    known = next((kind for kind, pattern in OTHER_KINDS.items() if pattern.search(words)), "")
    unknown = (mill.group() for mill in MILL.finditer(words) if not OF_FLAT.fullmatch(mill[1] or mill[2]))
    return known or next(unknown, "").lower()


def operation_name(comment: str) -> tuple[str, bool]:
    """The name of an operation that a comment gives, and whether it says that it is one; "" for other comments."""
    longest_name = 48
    announced = ANNOUNCED.fullmatch(comment)
    if announced and re.search(r"[^\W\d_]", announced.group(1)):
        return announced.group(1).strip()[:longest_name], True
    if len(comment) > longest_name or len(comment.split()) > 7 or not NAME.fullmatch(comment):
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

    beside: the comment is in the line of the change. In a comment without a tool number, which may name an operation
    (drill, chamfer), only the name of a tool counts (twist drill, chamfer mill).
    """
    comment = comment[:LONGEST]
    if re.match(r"\s*(?:stock|material|block|wcs|part)\b", comment, re.I):
        return None
    comment = ASIDE.sub(lambda match: match["size"] or " ", re.sub(r"(?<=\d),(?=\d)", ".", comment))
    old = re.match(r"(.*?)TOOL\s*-\s*0*(\d+)\s+DIA\. OFF", comment, re.I)
    numbered = re.match(rf"\s*(?:{TOOL_WORD}\s*(?:n[or]\.?\s*)?[-#:]?\s*|t\s*)0*(\d+)\b", comment, re.I)
    inside = re.search(r"\bT0*(\d+)\b", comment, re.I)
    number = next((match.group(k) for match, k in ((old, 2), (numbered, 1), (inside, 1)) if match), "")
    name = f"T{int(number)}" if number else changed
    diameter = _diameter(comment, unit)
    teeth = TEETH.search(comment)
    phrases = [" ".join(phrase.group().split()).lower().strip("- ") for phrase in KIND.finditer(comment)] or [""]
    operations = ("drill", "tap", "probe")  # names of operations and of tools
    words = next((phrase for phrase in phrases if phrase not in operations and kind_of(phrase)), phrases[0])
    about_tool = bool(number or beside or ABOUT_TOOL.match(comment))
    operation = words in operations
    kind = kind_of(comment if about_tool else "" if operation else words)
    if name is None or not (words or kind or teeth or (diameter and (number or re.search(r"\bdia", comment, re.I)))):
        return None
    count = int(next(filter(None, teeth.groups()))) if teeth else 0
    before = rf"{NUMBER}(?:\s*(?:mm|in|\")?\s*(?:CR|(?:corner )?rad(?:ius)?)|R)\b"
    corner = CORNER.search(comment) or re.search(before, comment, re.I)
    radius = float(corner.group(1)) * unit if corner else 0.0
    if radius > 0.51 * diameter > 0.0:  # a number of another thing, as R8 of a collet
        radius = 0.0
    return ProgramTool(
        name,
        words,
        diameter,
        count if 1 <= count <= 20 else 0,
        corner_radius=radius,
        kind=kind,
        inserts=INSERTS.search(comment) is not None,
        wear=re.search(r"\bwear comp", comment, re.I) is not None,  # Mastercam
    )


def _diameter(comment: str, unit: float) -> float:
    """[m]; 0 where the comment gives none, or a number that is no diameter of a cutter."""
    comment = comment.split("- ZMIN")[0]
    comment = re.sub(r"\|\s*[HD]\s*\d+\s*(?=\||$)", "|", comment)  # offset numbers of Mastercam
    comment = re.sub(r"DIA\. OFF\.\s*-\s*\d+", "", comment)
    diameter = 0.0
    if diameters := list(DIAMETER.finditer(comment)):
        number, mark = diameters[-1].groups()
        scale = {"mm": 1e-3, "in": 0.0254, "inch": 0.0254, '"': 0.0254}.get((mark or "").lower(), unit)
        diameter = float(number) * scale
    elif before := re.search(rf"{NUMBER}\s*dia(?:m|meter)?\b", comment, re.I):
        diameter = float(before.group(1)) * unit
    elif metric := re.search(rf"{NUMBER}\s*mm\b", comment, re.I):
        diameter = float(metric.group(1)) * 1e-3
    elif fraction := FRACTION.search(comment):
        whole, above, below = fraction.groups()
        diameter = (int(whole or 0) + int(above) / max(int(below), 1)) * 0.0254
    elif inches := re.search(rf"{NUMBER}\s*(?:\"|''|in\b|inch)", comment, re.I):
        diameter = float(inches.group(1)) * 0.0254
    elif mastercam := re.search(rf"\|\s*{NUMBER}\s+(?:{KIND.pattern})", comment, re.I):  # | 3. FLAT ENDMILL |
        diameter = float(mastercam.group(1)) * unit
    return diameter if 1e-5 < diameter <= 0.2 else 0.0
