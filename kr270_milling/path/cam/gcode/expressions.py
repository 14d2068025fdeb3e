"""Parameters and expressions of G-code: what a word states by a computation.

Grammar and functions: NIST RS274/NGC (Kramer 2000), 3.3.2 and 3.5, and the LinuxCNC reference; angles in degrees. The
R parameters of Sinumerik use the same operators, with parentheses.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable

NEAR = 1e-4  #: two numbers are equal, and a number is an integer, within this distance: LinuxCNC
MOST_VALUE = 1e12  #: a larger number cannot be meant; assumed


class ExpressionError(ValueError):
    """A computation without a result; the text says why."""


def _modulo(left: float, right: float) -> float:
    return math.fmod(left, right) % abs(right)


BINARY: dict[str, tuple[int, Callable[[float, float], float]]] = {
    "**": (5, operator.pow),
    "*": (4, operator.mul),
    "/": (4, operator.truediv),
    "MOD": (4, _modulo),
    "+": (3, operator.add),
    "-": (3, operator.sub),
    "EQ": (2, lambda left, right: float(abs(left - right) < NEAR)),
    "NE": (2, lambda left, right: float(abs(left - right) >= NEAR)),
    "GT": (2, operator.gt),
    "GE": (2, operator.ge),
    "LT": (2, operator.lt),
    "LE": (2, operator.le),
    "AND": (1, lambda left, right: float(bool(left) and bool(right))),
    "OR": (1, lambda left, right: float(bool(left) or bool(right))),
    "XOR": (1, lambda left, right: float(bool(left) != bool(right))),
}
FUNCTIONS: dict[str, Callable[[float], float]] = {
    "ABS": abs,
    "ACOS": lambda x: math.degrees(math.acos(x)),
    "ASIN": lambda x: math.degrees(math.asin(x)),
    "COS": lambda x: math.cos(math.radians(x)),
    "EXP": math.exp,
    "FIX": math.floor,
    "FUP": math.ceil,
    "LN": math.log,
    "ROUND": lambda x: math.floor(abs(x) + 0.5) * math.copysign(1.0, x),
    "SIN": lambda x: math.sin(math.radians(x)),
    "SQRT": math.sqrt,
    "TAN": lambda x: math.tan(math.radians(x)),
    "TRUNC": math.trunc,
}
NAME = re.compile("|".join(sorted(["EXISTS", "ATAN2", "ATAN", "PI", *FUNCTIONS], key=len, reverse=True)))
OPERATOR = re.compile(r"\*\*|[-+*/]|MOD|EQ|NE|GT|GE|LT|LE|AND|XOR|OR")
NUMBER = re.compile(r"[0-9]+\.?[0-9]*|\.[0-9]+")
CLOSING = {"[": "]", "(": ")"}


class Variables:
    """Parameters by number, ``#<name>`` and R; the machine answers for the numbers and names that are its state."""

    def __init__(self, of_machine: Callable[[int | str], float | None]):
        self.of_machine = of_machine
        self.values: dict[int | str, float] = {}
        #: of the program and of each sub-program that runs: its names and the numbers up to the first item
        self.scopes: list[tuple[int, dict[int | str, float]]] = [(0, {})]

    def _scope(self, key: int | str) -> dict[int | str, float]:
        """Return the place of a parameter; a name without _ belongs to the sub-program."""
        arguments, values = self.scopes[-1]
        local = not key.startswith(("_", "R ")) if isinstance(key, str) else key <= arguments
        return values if local else self.values

    def exists(self, key: int | str) -> bool:
        """Return whether a name has a value, or a parameter has a number of LinuxCNC."""
        if isinstance(key, int):
            return 1 <= key <= 5602
        return key in self._scope(key) or self.of_machine(key) is not None

    def get(self, key: int | str) -> float:
        """Return the value of a parameter; raise ExpressionError where the program gives it none."""
        value = self._scope(key).get(key)
        value = self.of_machine(key) if value is None else value
        if value is None:
            raise ExpressionError(f"{_shown(key)} has no value: the program does not set it before")
        return value

    def set(self, key: int | str, value: float) -> None:
        """Give a parameter a value; those of the control are read-only."""
        debug = 5599  # switches messages on (LinuxCNC)
        if key == 3000:
            raise ExpressionError("#3000 stops the program with an alarm (Fanuc, Haas)")
        if isinstance(key, int) and not 1 <= key <= 5000 and key != debug:
            raise ExpressionError(f"{_shown(key)} belongs to the control and cannot be set here")
        if isinstance(key, str) and self.of_machine(key) is not None:
            raise ExpressionError(f"{_shown(key)} belongs to the control and cannot be set here")
        self._scope(key)[key] = value


def _shown(key: int | str) -> str:
    if isinstance(key, int):
        return f"#{key}"
    return key.replace(" ", "") if key.startswith("R ") else f"#<{key.lower()}>"


class Scanner:
    """Reads values from an upper-case text without comments and, but for names, without blanks."""

    def __init__(self, text: str, variables: Variables):
        self.text = text
        self.variables = variables
        self.place = 0
        self.depth = 0

    @property
    def ended(self) -> bool:
        return self.place >= len(self.text)

    def take(self, text: str) -> bool:
        """Return whether the text continues with another text, and move past the latter."""
        if not self.text.startswith(text, self.place):
            return False
        self.place += len(text)
        return True

    def match(self, pattern: re.Pattern) -> str:
        """Return the match of a pattern at this place, and move past the match; "" without a match."""
        match = pattern.match(self.text, self.place)
        self.place = match.end() if match else self.place
        return match.group() if match else ""

    def key(self) -> int | str:
        """Return the number or the name of a parameter whose # was read."""
        if self.take("<"):
            end = self.text.find(">", self.place)
            if end <= self.place:
                raise ExpressionError("the name of a parameter is not closed with >")
            name, self.place = self.text[self.place : end], end + 1
            return name
        value = self.value()
        if abs(value - round(value)) > NEAR:
            raise ExpressionError(f"#{value:g} is no parameter; their numbers are whole")
        return round(value)

    def value(self) -> float:
        """Return a number, a parameter, a function or an expression in brackets."""
        most_nested = 100  # brackets in brackets; assumed
        self.depth += 1
        if self.depth > most_nested:
            raise ExpressionError(f"more than {most_nested} brackets are open")
        value = self._primary()
        self.depth -= 1
        if not abs(value) <= MOST_VALUE:
            raise ExpressionError(f"the result {value:g} is out of range")
        return float(value)

    def _primary(self) -> float:
        if self.take("-"):
            return -self.value()
        if self.take("+"):
            return self.value()
        if self.take("#"):
            return self.variables.get(self.key())
        if number := self.match(NUMBER):
            return float(number)
        opening = self.text[self.place : self.place + 1]
        if opening in CLOSING:
            return self._bracket()
        if name := self.match(NAME):
            return self._function(name)
        if opening == "R" and self.take("R"):
            return self.variables.get(f"R {self.match(NUMBER)}")
        raise ExpressionError(f"a value is expected where {self.text[self.place : self.place + 12]!r} is")

    def _function(self, name: str) -> float:
        if name == "PI":
            return math.pi
        if name == "EXISTS":
            inside = self.take("[#")
            key = self.key() if inside else 0
            if not inside or not self.take("]"):
                raise ExpressionError("EXISTS takes a parameter: EXISTS[#<name>]")
            return float(self.variables.exists(key))
        if name == "ATAN2" and self.take("("):
            first = self._expression(0)
            if not self.take(","):
                raise ExpressionError("ATAN2 takes two values")
            second = self._expression(0)
            self._close(")")
            return math.degrees(math.atan2(first, second))
        argument = self._bracket()
        if name == "ATAN":
            if not self.take("/"):
                raise ExpressionError("ATAN takes two values: ATAN[y]/[x]")
            return math.degrees(math.atan2(argument, self._bracket()))
        return self._computed(name, lambda: FUNCTIONS[name](argument))

    def _bracket(self) -> float:
        opening = self.text[self.place : self.place + 1]
        if opening not in CLOSING or not opening:
            raise ExpressionError("a bracket is expected after a function")
        self.place += 1
        value = self._expression(0)
        self._close(CLOSING[opening])
        return value

    def _close(self, bracket: str) -> None:
        if not self.take(bracket):
            raise ExpressionError(f"a bracket is not closed with {bracket}")

    def expression(self) -> float:
        """Return the result of an expression that no bracket encloses, as Sinumerik writes them after the sign =."""
        return self._expression(0)

    def _expression(self, least: int) -> float:
        """Return the value of what follows up to an operator of rank ``least`` or lower (precedence climbing)."""
        left = self.value()
        while match := OPERATOR.match(self.text, self.place):
            rank, function = BINARY[match.group()]
            if rank <= least:
                break
            self.place = match.end()
            right = self._expression(rank)
            left = self._computed(match.group(), lambda: function(left, right))  # noqa: B023
        return left

    def _computed(self, name: str, function: Callable[[], float]) -> float:
        try:
            value = function()
        except (ValueError, ZeroDivisionError, OverflowError):
            value = math.nan
        if isinstance(value, complex) or not abs(value) <= MOST_VALUE:
            raise ExpressionError(f"{name} has no result here")
        return float(value)
