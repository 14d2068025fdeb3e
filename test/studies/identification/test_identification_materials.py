"""The shipped table of published force coefficients."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.base.errors import InputError
from kr270_milling.physics.cutting.materials import find_material, materials


def test_every_material_has_a_source_and_the_coefficients_of_the_milling_plane():
    rows = materials()
    assert len(rows) >= 6
    for row in rows:
        assert "10.1186/s10033-021-00536-9" in row.source and np.isfinite(row.values[:4]).all()
    assert find_material("al7075-T6")[0].values[0] == pytest.approx(600.46e6)
    with pytest.raises(InputError, match="has no material"):
        find_material("wood")
