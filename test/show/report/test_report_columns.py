"""base.column: one field gives the columns of JSON, terminal and report."""

from __future__ import annotations

from dataclasses import dataclass, fields

import pytest

from kr270_milling.base.column import as_dict, column, columns
from kr270_milling.decide.part import FeatureRow
from kr270_milling.physics.motion.scores import Scores
from kr270_milling.show.commands.console import columns_of, table_of
from kr270_milling.show.report.tables import line_scores, micro


@dataclass(frozen=True)
class Row:
    name: str
    deviation: float = column("deviation_mm", 1e3, "largest deviation", "um", 1e6, 2, short="max")
    hidden: float = column("", 1.0)


def test_a_field_is_a_key_of_json_and_a_column_of_the_terminal():
    row = Row("wall", 25e-6, 1.0)
    assert as_dict(row) == {"deviation_mm": pytest.approx(0.025)}
    assert [c.heading() for c in columns(Row)] == ["largest deviation [um]", ""]
    table = table_of("Title", (("name", "name", 0), *columns_of(Row)), [{"name": "wall", **as_dict(row)}])
    assert table.columns == ["name", "max [um]"] and table.rows == [["wall", "25.00"]]
    assert columns_of(Row, unit="um")[0][0] == "max"


@pytest.mark.parametrize("record", [FeatureRow, Scores])
def test_every_number_of_a_result_has_a_column(record):
    assert {c.name for c in columns(record)} == {field.name for field in fields(record)} - {"name"}


def test_the_table_of_the_scores_has_every_titled_column(demo):
    headings = line_scores(list(demo.passes.values()), paper=True).columns
    titled = [micro(c.heading()) for c in columns(Scores) if c.title]
    assert [heading for heading in headings if heading not in ("pass", "paper")] == titled
    assert headings.count("paper") == 3
