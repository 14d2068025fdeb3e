"""Values and expressions of KRL: numbers, texts, structures such as FRAME, and the operators between them.

A structure is a dict of its components. Angles are in degrees and lengths in mm, as the program writes them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from kr270_milling.base.files import short
from kr270_milling.base.frames import Pose, abc_from_rotation

FRAME = ("X", "Y", "Z", "A", "B", "C")
TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:E[-+]?\d+)?)|(?P<name>[$A-Z_][\w$]*)|(?P<word>\#[A-Z_]\w*)"
    r"|'(?P<bits>[BH][0-9A-F]+)'"
    r'|(?P<text>"[^"]*")|(?P<sign><=|>=|<>|==|[-+*/():,{}\[\].<>]))',
    re.I | re.A,
)
#: operator -> rank, a higher one binds closer, as KUKA's manual "Expert Programming" lists them; the rank of ``:``,
#: which joins two frames, is assumed
RANKS = {"==": 1, "<>": 1, "<": 1, ">": 1, "<=": 1, ">=": 1, "OR": 2, "EXOR": 3, "AND": 4, "+": 5, "-": 5,
         "*": 6, "/": 6, ":": 7}  # fmt: skip
FUNCTIONS: dict[str, Callable] = {
    "ABS": abs,
    "SQRT": math.sqrt,
    "SIN": lambda x: math.sin(math.radians(x)),
    "COS": lambda x: math.cos(math.radians(x)),
    "TAN": lambda x: math.tan(math.radians(x)),
    "ACOS": lambda x: math.degrees(math.acos(x)),
    "ATAN2": lambda y, x: math.degrees(math.atan2(y, x)),
}
DEEPEST = 50  # brackets in brackets


class KrlError(ValueError):
    """A statement that cannot be run; the text says why."""


class UnknownValueError(KrlError):
    """A name whose value the files of the program do not give."""

    def __init__(self, name: str):
        super().__init__(f"{short(name)} has no value in the program and its .dat file")


def parts(text: str, sign: str = ",") -> list[str]:
    """Split at the signs outside of brackets and quotes; the parts are stripped."""
    pieces, depth, quoted, start = [], 0, False, 0
    for k, letter in enumerate(text):
        quoted ^= letter == '"'
        if quoted:
            continue
        depth += (letter in "([{") - (letter in ")]}")
        if letter == sign and not depth:
            pieces.append(text[start:k].strip())
            start = k + 1
    return [*pieces, text[start:].strip()]


def composed(left: dict, right: dict) -> dict:
    """Return the frame ``left : right``: right is given in left."""
    poses = []
    for frame in (left, right):
        x, y, z, *abc = (float(frame.get(name, 0.0)) for name in FRAME)
        poses.append(Pose.from_abc((x, y, z), np.radians(abc)))
    both = poses[0] @ poses[1]
    row = [*both.position.tolist(), *np.degrees(abc_from_rotation(both.rotation)).tolist()]
    return right | dict(zip(FRAME, row, strict=True))


def evaluated(text: str, value_of: Callable[[str], Any]) -> Any:
    """Return the value of an expression; value_of: that of a variable such as "P[3]". Raises KrlError."""
    tokens, end = [], 0
    while end < len(text.rstrip()):
        match = TOKEN.match(text, end)
        if match is None:
            raise KrlError(f"{short(text[end:].strip())!r} is no expression")
        tokens.append((str(match.lastgroup), match[match.lastgroup or 0]))
        end = match.end()
    scanner = _Scanner(tokens, value_of)
    try:
        value = scanner.expression(0)
    except (TypeError, ValueError, ArithmeticError, AttributeError, IndexError) as error:
        if isinstance(error, KrlError):
            raise
        raise KrlError(f"{short(text)!r} has no value") from None
    if scanner.tokens:
        raise KrlError(f"{short(text)!r} is no expression")
    return value


class _Scanner:
    """Takes tokens from the front: first the operand, then operators that bind closer than a rank."""

    def __init__(self, tokens: list[tuple[str, str]], value_of: Callable[[str], Any]):
        self.tokens = tokens
        self.value_of = value_of
        self.depth = 0

    def expression(self, rank: int) -> Any:
        self.depth += 1
        if self.depth > DEEPEST:
            raise KrlError(f"more than {DEEPEST} brackets in each other")
        value = self._operand()
        while self.tokens and RANKS.get(sign := self.tokens[0][1].upper(), 0) > rank:
            self.tokens.pop(0)
            value = _joined(sign, value, self.expression(RANKS[sign]))
        self.depth -= 1
        return value

    def _take(self, sign: str) -> bool:
        if self.tokens and self.tokens[0][1] == sign:
            self.tokens.pop(0)
            return True
        return False

    def _need(self, sign: str) -> None:
        if not self._take(sign):
            raise KrlError(f"{sign} is missing")

    def _operand(self) -> Any:
        if not self.tokens:
            raise KrlError("a value is missing")
        kind, token = self.tokens.pop(0)
        match kind, token.upper():
            case "number", digits:
                return int(digits) if digits.isdigit() else float(digits)
            case "bits", digits:
                return int(digits[1:], 2 if digits[0] == "B" else 16)
            case (("word" | "text"), word):
                return word.strip('"') if kind == "text" else word
            case _, "-":
                return -self.expression(max(RANKS.values()))
            case _, "+":
                return self.expression(max(RANKS.values()))
            case _, "NOT":
                return not _truth(self.expression(max(RANKS.values())))
            case _, "(":
                value = self.expression(0)
                self._need(")")
                return value
            case _, "{":
                return self._structure()
            case "name", name:
                return self._named(name)
        raise KrlError(f"{token} is no value")

    def _named(self, name: str) -> Any:
        if name in ("TRUE", "FALSE"):
            return name == "TRUE"
        if name in FUNCTIONS and self._take("("):
            return FUNCTIONS[name](*self._list(")"))
        if self._take("["):
            name += f"[{','.join(str(int(index)) for index in self._list(']'))}]"
        value = self.value_of(name)
        while self._take("."):
            component = self.tokens.pop(0)[1].upper()
            if not isinstance(value, dict) or component not in value:
                raise UnknownValueError(f"{name}.{component}")
            value = value[component]
        return value

    def _list(self, end: str) -> list:
        values = [self.expression(0)]
        while self._take(","):
            values.append(self.expression(0))
        self._need(end)
        return values

    def _structure(self) -> dict:
        """``{X 1,Y 2}``, also ``{FRAME: X 1}``."""
        if len(self.tokens) > 1 and self.tokens[1][1] == ":":
            del self.tokens[:2]
        values: dict[str, Any] = {}
        while not self._take("}"):
            name = self.tokens.pop(0)[1].upper()
            if self._take("["):
                name += f"[{','.join(map(str, self._list(']')))}]" if not self._take("]") else "[]"
            values[name] = self.expression(0)
            if not self._take(",") and (not self.tokens or self.tokens[0][1] != "}"):
                raise KrlError("} is missing")
        return values


def _truth(value) -> bool:
    if not isinstance(value, bool):
        raise KrlError(f"{short(str(value))} is neither TRUE nor FALSE")
    return value


def _joined(sign: str, left: Any, right: Any) -> Any:
    match sign:
        case "+":
            return left + right
        case "-":
            return left - right
        case "*":
            return left * right
        case "/":
            whole = isinstance(left, int) and isinstance(right, int)
            return int(left / right) if whole else left / right
        case ":":
            return composed(left, right)
        case "AND":
            return _truth(left) and _truth(right)
        case "OR":
            return _truth(left) or _truth(right)
        case "EXOR":
            return _truth(left) != _truth(right)
        case "==" | "<>":
            return (left == right) == (sign == "==")
        case "<" | ">=":
            return (left < right) == (sign == "<")
    return (left > right) == (sign == ">")
