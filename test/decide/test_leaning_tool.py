"""Each collision of a tilted tool in closed form is a stop, and the same programs beside the collision are sound."""

from __future__ import annotations

import pytest
from budget import LONG
from samples.leaning import SHAPES, TILTS, Slot

from kr270_milling.cell.models import path_of
from kr270_milling.decide.check_cut import path_contacts

#: a long run has all 177 collisions
SLOTS = [(shape, tilt) for k, tilt in enumerate(TILTS) for n, shape in enumerate(SHAPES) if LONG or (k + n) % 3 == 0]


def contacts(cell) -> list:
    parts = path_contacts(cell, path_of(cell).target)
    return [finding for part in parts for finding in part if finding.severity == "stop"]


@pytest.mark.parametrize("number", range(len(SLOTS)))
def test_each_collision_of_a_leaning_tool_is_found_with_its_depth_and_the_sound_program_has_none(tmp_path, number):
    """0.3 mm beside a collision is sound; depths to 0.15 mm, the width of a cell of the map."""
    slot = Slot(*SLOTS[number])
    rows = list(slot.collisions().items())
    for name, row in rows if LONG else rows[number % 8 :: 8]:
        named = [f for f in contacts(slot.cell(tmp_path, row.settings, row.moves)) if f.what == row.kind]
        values = [f.value for f in named if row.words in f.sentence]
        assert values, (name, SLOTS[number])
        assert row.value is None or max(values) == pytest.approx(row.value, abs=0.15), (name, SLOTS[number])
        assert not contacts(slot.cell(tmp_path, row.sound)), (name, SLOTS[number])
