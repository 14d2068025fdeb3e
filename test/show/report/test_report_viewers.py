"""What viewers show beside the page: columns of JSON and terminal, the robot, and the layout files in config."""

import json
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass, fields
from types import SimpleNamespace

import numpy as np
import pytest
from samples.recording_samples import sample

from kr270_milling.base.column import as_dict, column, columns, columns_of, computed, table_of
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.arm import commanded_joints
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.decide.part import FeatureRow
from kr270_milling.exchange.scene import OUTPUTS
from kr270_milling.physics.motion.scores import Scores
from kr270_milling.physics.robot.urdf import links_of, urdf
from kr270_milling.recordings.messages.topics import TOPICS
from kr270_milling.show.report.linked import robot_model


@dataclass(frozen=True)
class Row:
    deviation: float = column("deviation_mm", 1e3, "largest deviation", "um", 1e6, 2, short="max")
    limit: float = column("limit_mm", 1e3, unit="mm", short="limit", infinite="above 100")


@dataclass(frozen=True)
class Rows:
    name: str = column("name", short="name")
    unwritten: float = column("")
    missing: float | None = column("missing_um", 1e6)
    rows: tuple[Row, ...] = column("rows")
    flat: Row = column("*")

    @computed("whole", short="whole")
    def whole(self) -> bool:
        return len(self.rows) == 2


def test_a_record_becomes_one_dictionary_with_its_records_and_texts():
    row = Row(25e-6, 50e-6)
    written = as_dict(Rows("a", 1.0, None, (row, row), row))
    assert written == {"name": "a", "missing_um": None, "rows": [as_dict(row)] * 2, **as_dict(row), "whole": True}
    assert table_of("Title", columns_of(Rows), [written]).rows == [["a", "yes"]]


def test_a_field_is_a_key_of_json_and_a_column_of_the_terminal():
    rows = [as_dict(Row(25e-6, 50e-6)), as_dict(Row(np.nan, np.inf))]
    assert rows[0] == pytest.approx({"deviation_mm": 0.025, "limit_mm": 0.05})
    table = table_of("Title", columns_of(Row), rows)
    assert table.columns == ["max [um]", "limit [mm]"]
    assert table.rows == [["25.00", "0.1"], ["-", "above 100"]]


@pytest.mark.parametrize("record", [FeatureRow, Scores])
def test_every_number_of_a_result_has_a_column(record):
    assert {c.name for c in columns(record)} == {field.name for field in fields(record)}


# --- robot.urdf, its solids, and report.robot_model: the robot that viewers and the page show ---
@pytest.fixture(scope="module", params=["paper.yaml", "test_piece.yaml"])
def cell(request):
    return read_cell(find_file(request.param))


@pytest.fixture(scope="module")
def text(cell):
    return urdf(cell.arm, cell.mount, cell.tool.radius, cell.workpiece.pose)


def test_the_solids_of_every_link_are_closed_and_the_tool_ends_in_the_tip(cell, text):
    meshes = {link.name: link.meshes for link in links_of(text)}
    for name in ("base_link", *(f"link_{j}" for j in range(1, 7)), "tcp"):
        assert meshes[name], name
        for mesh in meshes[name]:
            corners = mesh.vertex[mesh.triangle]
            volume = np.sum(np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6
            assert volume > 0.0
            edges = np.concatenate([mesh.triangle[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))])
            assert {tuple(e) for e in edges} == {tuple(e[::-1]) for e in edges}
    vertices = np.vstack([mesh.vertex for mesh in meshes["tcp"]])
    assert vertices[:, 2].max() == pytest.approx(0.0, abs=1e-9)  # z points from the flange to the tip
    at_tip = vertices[np.abs(vertices[:, 2]) < 1e-9]
    assert np.hypot(*at_tip[:, :2].T).max() == pytest.approx(cell.tool.radius, abs=1e-9)


def test_the_posture_is_the_commanded_one_not_that_of_the_file(cell):
    cell = cell.replace(compensation=cell.compensation.replace(sag_compensated=False))
    reference = path_of(cell).target
    of_cell, shown = (arm_of(cell), cell.compensation), SimpleNamespace(reference=reference, name="original")
    model = robot_model(*of_cell, cell.stock, shown)
    np.testing.assert_allclose(model["joints"][0], commanded_joints(*of_cell, reference)[0], atol=1e-9)
    assert np.abs(model["joints"][0] - arm_of(cell).posture).max() > 1e-4  # [rad], of the sag
    assert model["time"][-1] == pytest.approx(reference.duration_ns * 1e-9)


# --- The layout files in config ---
def test_every_curve_and_topic_of_the_layouts_is_in_the_messages():
    panels = json.loads(find_file("viewer_layout.json").read_text())["configById"].values()
    topics = {topic for panel in panels for topic in panel.get("topics", {})}
    assert topics and topics <= {f"/{name}" for name in (topic.name for topic in TOPICS)} | set(OUTPUTS)
    curves = [path["value"] for panel in panels for path in panel.get("paths", [])]
    names = [curve.get("name") for curve in ET.parse(find_file("plotjuggler_layout.xml")).iter("curve")]
    curves += [re.sub("joint_[1-6]/position", "position[0]", name) for name in names]  # PlotJuggler names the joints
    assert len(curves) == 12 + 15
    for curve in curves:
        topic, *fields = re.findall(r"\w+", curve)
        value = sample(f"/{topic}", step=1)
        for field in fields:
            value = value[int(field)] if field.isdigit() else getattr(value, field)
        assert isinstance(value, float), curve
