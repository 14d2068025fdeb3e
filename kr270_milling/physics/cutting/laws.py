"""The table of force laws, and the section ``cutting`` of a parameter file."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import ConfigError, ParameterError
from kr270_milling.base.extensions import load_as, registered
from kr270_milling.base.record import Record, parameter, specs
from kr270_milling.physics.cutting.force_law import ForceLaw
from kr270_milling.physics.cutting.fractional import FractionalLaw
from kr270_milling.physics.cutting.linear_edge import LinearEdgeLaw

#: every force law, by its name in a parameter file
LAWS: dict[str, type[ForceLaw]] = {"fractional": FractionalLaw, "linear_edge": LinearEdgeLaw}


def _is_law(kind) -> bool:
    return isinstance(kind, type) and issubclass(kind, ForceLaw)


LAWS |= {point.name: load_as(point, _is_law, "subclass of ForceLaw") for point in registered("force_laws", LAWS)}

for name, law in LAWS.items():
    if law.fault():
        raise ConfigError(f"force law {name}", "", None, law.fault())


def _with_laws(record: type) -> type:
    """Give a record a group of coefficients for each law, after its first field."""
    first, *others = record.__annotations__.items()
    record.__annotations__ = dict([first, *((name, law) for name, law in LAWS.items()), *others])
    for name, law in LAWS.items():
        setattr(record, name, law())
    return record


@dataclass(frozen=True, eq=False)
@_with_laws
class Cutting(Record):
    """YAML ``cutting``: which law applies, and its coefficients; raises ParameterError for a missing coefficient."""

    law: str = parameter("fractional", choices=tuple(LAWS), text="force law")
    chip_angle: str = parameter(
        "previous_centre",
        choices=("previous_centre", "nominal"),
        text="dphi of h = A / (R dphi): as seen from the tool centre of the step before, as section 4 has it; nominal: "
        "the spindle's, which damps vibrations along the tooth's motion too much",
    )
    detail: str = parameter(
        "auto",
        choices=("teeth", "engagement", "auto"),
        text="model of the cut: the sweep of the teeth, or the mean force of the engagement for long programs; auto: "
        "teeth for a straight cut and for programs of up to 60 s of cutting with an upright flat end",
    )
    # assumed: the dish of an end mill keeps the inner part of its end off the floor; no measured thrust is published
    end_share: float = parameter(
        0.2,
        low=0.0,
        high=1.0,
        text="share of the radius over which the end edge of a sinking tool touches the floor",
    )
    moments: bool = parameter(
        True, text="moments of the forces about the tool tip, reaction torque of the spindle; false: forces only, (29)"
    )

    def check(self) -> None:
        for spec in specs(type(self.active)):
            if math.isnan(getattr(self.active, spec.name)):
                must = f"given where cutting.law is {self.law}: {spec.allowed} ({spec.text})"
                raise ParameterError(f"{self.law}.{spec.key}", None, must)

    @property
    def by_engagement(self) -> bool:
        """Return whether the model of the cut is the mean force of the engagement, and not the sweep of the teeth."""
        return self.detail == "engagement"

    @property
    def active(self) -> ForceLaw:
        """The law that applies, with its coefficients."""
        return getattr(self, self.law)

    @property
    def coefficients(self) -> np.ndarray:
        """Coefficients of the law that applies [SI], (p,)."""
        return self.active.coefficients

    @property
    def axial(self) -> bool:
        """Return whether the law has an axial force at all."""
        return self.active.axial

    def force_per_depth(self, h):
        """Tangential and radial force per depth of cut [N/m] at chip thickness h [m] (number or array)."""
        return self.active.per_depth(h)[:2]

    def axial_per_depth(self, h):
        """Axial force per depth of cut [N/m] at chip thickness h [m] (number or array)."""
        return self.active.per_depth(h)[2]
