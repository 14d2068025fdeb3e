"""Force laws: coefficients, one compiled function, and the methods that fit, scatter and show them.

A law is a subclass of ``ForceLaw`` and a row of ``laws.LAWS``; no other file asks for the name of a law.
"""

from __future__ import annotations

import dis
import functools
import inspect
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol

import numpy as np
from llvmlite import ir
from numba import cfunc, types
from numba.core import cgutils
from numba.core.errors import NumbaError
from numba.extending import intrinsic

from kr270_milling.base.compiled import compiled, inlined
from kr270_milling.base.errors import ConfigError
from kr270_milling.base.record import Record, specs
from kr270_milling.base.units import UNITS
from kr270_milling.physics.cutting.tool import Tool

FORCES = types.UniTuple(types.float64, 3)
MOST = 12  #: coefficients of a law, for which ``call_law`` has code
SMALLEST, OCTAVES = 2.0**-40, 36  # [m], chip thicknesses of ``ForceLaw.table``: from 1 pm to 6 cm
SHIFT = 46  # bits of a number below those that choose its row: 6 of its fraction do
FIRST = int(np.float64(SMALLEST).view(np.int64)) >> SHIFT
POINTS = np.polynomial.legendre.leggauss(48)


class Cuts(Protocol):
    """n cuts at constant feed and depth with one tool; ``identification.forces`` has the record."""

    @property
    def tool(self) -> Tool: ...

    @property
    def feed_per_tooth(self) -> np.ndarray:
        """[m], (n,)."""

    @property
    def depth(self) -> np.ndarray:
        """[m], (n,)."""

    @property
    def entry(self) -> np.ndarray:
        """Angle of a tooth where the chip begins [rad], (n,), from the feed, in the sense of rotation."""

    @property
    def exit(self) -> np.ndarray:
        """Angle where the chip ends [rad], (n,)."""


class ChartLine(NamedTuple):
    """A line that the chart of a law shows beside its forces."""

    name: str
    per_depth: np.ndarray  #: [N/m]
    colour: int


@dataclass(frozen=True, eq=False)
class ForceLaw(Record):
    """The coefficients of a law. The class attributes describe the law itself."""

    #: compiled for the sweep: force(h, ...) of the chip thickness h [m] and of each coefficient [SI] by its name,
    #: -> F_t, F_r, F_a per depth of cut [N/m]
    force: ClassVar[Callable[..., tuple[float, float, float]]]
    #: coefficients that the verdict varies
    scattered: ClassVar[tuple[str, ...]]
    #: coefficients of the axial force, which is linear in each; the verdict varies them where one of them is not 0
    axial_names: ClassVar[tuple[str, ...]] = ()
    #: where a fit of the other coefficients starts [SI]; not needed where ``design`` has an answer
    start: ClassVar[tuple[float, ...]] = ()
    #: lower and upper ends of the range in which the fit looks for each of these [SI]
    searched: ClassVar[tuple[tuple[float, float], ...]] = ()
    least_feeds: ClassVar[int] = 2  #: different feeds per tooth that identify the coefficients
    symbol: ClassVar[str] = "diamond-open"  #: marker in charts
    caption: ClassVar[str] = ""  #: a sentence below the chart of the law

    @property
    def coefficients(self) -> np.ndarray:
        """All coefficients in their order [SI], (p,)."""
        return np.array([getattr(self, spec.name) for spec in specs(type(self))])

    @property
    def arguments(self) -> np.ndarray:
        """Return the coefficients in the order of the arguments of ``force`` [SI], (p,)."""
        return np.array([getattr(self, name) for name in _names(type(self).force)])

    @property
    def axial(self) -> bool:
        """Return whether the law has an axial force."""
        return any(getattr(self, name) != 0.0 for name in self.axial_names)

    def grown(self, factor: float) -> ForceLaw:
        """The law of a worn edge: every coefficient that is a force, by its unit, times the factor."""
        forces = [spec.name for spec in specs(type(self)) if spec.unit.startswith("n_per")]
        return self.replace(**{name: factor * getattr(self, name) for name in forces})

    def wrong_forces(self) -> str:
        """Return a sentence on a chip whose forces are not finite, or F_t negative; empty: there is none."""
        for h in np.geomspace(1e-8, 1e-3, 31).tolist():  # [m]
            try:
                with np.errstate(all="ignore"):
                    forces = np.array(type(self).force(h, *self.arguments.tolist()), float)
            except ArithmeticError as error:
                return f"{error} at a chip of {1e6 * h:.3g} um"
            if not np.isfinite(forces).all() or forces[0] < 0.0:
                values = ", ".join(f"{1e-3 * force:.4g}" for force in forces)
                return f"F_t, F_r, F_a are {values} N/mm at a chip of {1e6 * h:.3g} um"
        return ""

    @classmethod
    def fault(cls) -> str:
        """Return a sentence on attributes of the class that are missing or contradict each other; empty: they fit."""
        missing = [name for name in ("force", "scattered") if not hasattr(cls, name)]
        if missing:
            return f"the class has no attribute {missing[0]}"
        names = [spec.name for spec in specs(cls)]
        units = [spec.unit for spec in specs(cls) if spec.unit not in UNITS]
        if units:
            return f"the unit {units[0]!r} is not one of {', '.join(filter(None, UNITS))}"
        unknown = [name for name in (*cls.scattered, *cls.axial_names) if name not in names]
        if unknown:
            return f"scattered and axial_names have {unknown[0]}, which is no coefficient"
        arguments = _names(cls.force)
        if sorted(arguments) != sorted(names) or len(names) > MOST:
            return f"force must take h and the coefficients, at most {MOST}, by their names: {', '.join(names)}"
        if any(step.opname == "RAISE_VARARGS" for step in dis.get_instructions(cls.force)):
            return "force must not raise: compiled code ignores the error, and the force would be 0"
        searched = len(names) - len(cls.axial_names)
        linear = cls.design.__qualname__ != ForceLaw.design.__qualname__
        if not linear and not len(cls.start) == len(cls.searched) == searched:
            return f"start and searched must have {searched} entries, one for each coefficient that is not axial"
        return ""

    @classmethod
    def address(cls) -> int:
        """Return the address of the compiled ``force`` in the memory of this process; see ``_call_law``.

        Raises ConfigError where Numba does not compile it.
        """
        try:
            return _compiled(cls.force).address
        except NumbaError as error:
            lines = [line.strip() for line in re.sub(r"\x1b\[[0-9;]*m", "", str(error)).splitlines()]
            reasons = [line for line in lines if line and not line.startswith(("Failed in", "During:", "- "))]
            reason = reasons[0].partition(" for '$")[0] if reasons else type(error).__name__
            raise ConfigError(f"force law {cls.__name__}", "force", None, f"cannot be compiled ({reason})") from None

    def per_depth(self, h) -> tuple:
        """F_t / a_p, F_r / a_p and F_a / a_p [N/m] at chip thickness h [m], a number or an array."""
        h = np.asarray(h, float)
        forces = np.empty((3, h.size))
        _fill(self.address(), np.ascontiguousarray(h).ravel(), self.arguments, forces)
        return tuple(forces.reshape(3, *h.shape)[k][()] for k in range(3))

    @property
    def table(self) -> np.ndarray:
        """F_t, F_r and F_a as lines over h, each offset and slope, in the rows that ``forces_at`` looks up, (n, 6).

        There are 64 rows for each octave of h: a power of h below 1 is within 2e-5, and a straight line is exact.
        """
        h = (np.arange(FIRST, FIRST + 64 * OCTAVES + 1) << SHIFT).view(np.float64)
        forces = np.stack(self.per_depth(h), -1)
        slopes = np.diff(forces, axis=0) / np.diff(h)[:, None]
        return np.stack([forces[:-1] - slopes * h[:-1, None], slopes], -1).reshape(-1, 6)

    def slopes(self, h: np.ndarray) -> tuple:
        """K = dF / dh / a_p [N/m^2], tangential, radial and axial, by a central difference; h [m] > 0."""
        step = 1e-3 * h  # the central difference spans 0.2 % of the chip thickness
        above, below = self.per_depth(h + step), self.per_depth(h - step)
        return tuple((a - b) / (2 * step) for a, b in zip(above, below, strict=True))

    def mean_forces(self, cuts: Cuts) -> np.ndarray:
        """Mean forces over a revolution on the tool [N], (n, 3), workpiece axes, by Gauss' rule.

        With h = f cos(phi), N teeth and the depth a, from entry to exit (29):
        F_x = N / 2 pi int (F_t sin(phi) - F_r cos(phi)) dphi, F_z = -N / 2 pi int F_a dphi,
        F_y = -sense N / 2 pi int (F_t cos(phi) + F_r sin(phi)) dphi.
        """
        half = (cuts.exit - cuts.entry)[:, None] / 2
        phi = cuts.entry[:, None] + half * (1 + POINTS[0])
        sine, cosine = np.sin(phi), np.cos(phi)
        tangential, radial, axial = self.per_depth(cuts.feed_per_tooth[:, None] * cosine)
        weight = half * POINTS[1] * (cuts.tool.teeth * cuts.depth / (2 * np.pi))[:, None]
        f_x = np.sum(weight * (tangential * sine - radial * cosine), axis=1)
        f_y = -cuts.tool.sense * np.sum(weight * (tangential * cosine + radial * sine), axis=1)
        return np.stack([f_x, f_y, -np.sum(weight * axial, axis=1)], -1)

    @classmethod
    def design(cls, cuts: Cuts) -> np.ndarray | None:
        """Derivatives of the mean forces by the coefficients, (n, 3, p), of a law that is linear in all of them."""
        return None

    @classmethod
    def result_keys(cls) -> tuple[str, ...]:
        """Names of the coefficients in the JSON of ``identify forces``, with units."""
        return tuple(spec.key for spec in specs(cls))

    def lines(self, h: np.ndarray) -> list[ChartLine]:
        """Lines that the chart shows beside the forces at chip thicknesses h [m]."""
        return []

    def marks(self) -> list[tuple[float, str]]:
        """Chip thicknesses [m] that the chart marks, and their names."""
        return []

    def assumptions(self, feed_per_tooth: float) -> list[tuple[str, str, str]]:
        """Subject, value and reason of the assumptions of this law that a report lists; feed_per_tooth [m]."""
        return []


@functools.cache
def _names(force: Callable) -> tuple[str, ...]:
    """Return the names of the arguments of a ``force`` after the chip thickness."""
    return tuple(inspect.signature(force).parameters)[1:]


@functools.cache
def _compiled(force: Callable):
    numbers = [types.float64] * (1 + len(_names(force)))
    return cfunc(FORCES(*numbers), cache=True, error_model="numpy")(force)


def _call_law(typing_context, address, h, arguments):
    """Call the law at an address (int64): h [m] and ``arguments`` (p,) -> F_t, F_r, F_a per depth of cut [N/m].

    The address is a number, so one compilation serves every law, with one case for each number of arguments.
    """

    def codegen(context, builder, signature, values):
        address, h, arguments = values
        array = context.make_array(signature.args[2])(context, builder, arguments)
        data, size = array.data, array.nitems
        number, forces = context.get_value_type(types.float64), context.get_value_type(FORCES)
        result = cgutils.alloca_once(builder, forces)
        unknown, end = (builder.append_basic_block(name) for name in ("unknown", "end"))
        cases = builder.switch(size, unknown)
        for count in range(1, MOST + 1):
            block = builder.append_basic_block(f"arguments_{count}")
            cases.add_case(size.type(count), block)
            with builder.goto_block(block):
                places = (builder.gep(data, [size.type(k)]) for k in range(count))
                target = builder.inttoptr(address, ir.FunctionType(forces, [number] * (1 + count)).as_pointer())
                builder.store(builder.call(target, [h, *map(builder.load, places)]), result)
                builder.branch(end)
        builder.position_at_end(unknown)
        builder.unreachable()
        builder.position_at_end(end)
        return builder.load(result)

    return FORCES(types.int64, types.float64, arguments), codegen


call_law: Callable = intrinsic(_call_law)


@compiled
def _fill(address, h, arguments, forces):
    for i in range(h.size):
        forces[0, i], forces[1, i], forces[2, i] = call_law(address, h[i], arguments)


@inlined
def forces_at(law, h):
    """Return F_t, F_r, F_a per depth of cut [N/m] at a chip thickness h [m]; law: ``ForceLaw.table``.

    A call of the law took a third of the time of the mean force of a bin, and cannot become vector instructions.
    """
    row = law[np.uint64(min(max((np.float64(h).view(np.int64) >> SHIFT) - FIRST, 0), law.shape[0] - 1))]
    return row[0] + row[1] * h, row[2] + row[3] * h, row[4] + row[5] * h
