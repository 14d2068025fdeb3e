"""What viewers show beside the page: columns of JSON and terminal, the robot, and the layout files in config."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass, fields
from types import SimpleNamespace

import numpy as np
import pytest

from kr270_milling.base.column import as_dict, column, columns, columns_of, computed, table_of
from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import commanded_joints
from kr270_milling.decide.part import FeatureRow
from kr270_milling.exchange.replay.inputs import TYPES
from kr270_milling.exchange.scene import OUTPUTS
from kr270_milling.physics.motion.scores import Scores
from kr270_milling.physics.robot import forward
from kr270_milling.physics.robot.urdf import urdf
from kr270_milling.physics.robot.urdf_links import links_of
from kr270_milling.recordings.messages.definitions import store_of
from kr270_milling.show.report.robot_model import robot_model
from kr270_milling.show.report.tables import line_scores, micro


@dataclass(frozen=True)
class Row:
    name: str
    deviation: float = column("deviation_mm", 1e3, "largest deviation", "um", 1e6, 2, short="max")
    limit: float = column("limit_mm", 1e3, unit="mm", short="limit", infinite="above 100")
    hidden: float = column("", 1.0)

    @computed("share", short="share", digits=1)
    def share(self) -> float:
        return self.deviation / self.limit


def test_a_field_is_a_key_of_json_and_a_column_of_the_terminal():
    row, endless = Row("wall", 25e-6, 50e-6, 1.0), Row("floor", np.nan, np.inf, 1.0)
    assert as_dict(row) == pytest.approx({"deviation_mm": 0.025, "limit_mm": 0.05, "share": 0.5})
    assert [c.heading() for c in columns(Row)] == ["largest deviation [um]", " [mm]", "", ""]
    rows = [{"name": one.name, **as_dict(one)} for one in (row, endless)]
    table = table_of("Title", (("name", "name", 0), *columns_of(Row)), rows)
    assert table.columns == ["name", "max [um]", "limit [mm]", "share"]
    assert table.rows == [["wall", "25.00", "0.1", "0.5"], ["floor", "-", "above 100", "-"]]
    assert columns_of(Row, unit="um")[0][0] == "max"


def test_every_number_of_a_result_has_a_column_and_the_table_of_the_scores_every_titled_one(straight):
    for record in (FeatureRow, Scores):
        assert {c.name for c in columns(record)} == {field.name for field in fields(record)} - {"name"}
    headings = line_scores(straight[1], paper=True).columns
    titled = [micro(c.heading()) for c in columns(Scores) if c.title]
    assert [heading for heading in headings if heading not in ("pass", "paper")] == titled
    assert headings.count("paper") == 3


# --- robot.urdf, its solids, and report.robot_model: the robot that viewers and the page show ---
@pytest.fixture(scope="module", params=["paper.yaml", "test_piece.yaml"])
def cell(request):
    return read_cell(find_file(request.param))


@pytest.fixture(scope="module")
def text(cell):
    return urdf(cell.arm, cell.mount, cell.tool.radius, cell.workpiece.pose)


def test_pinocchio_puts_every_frame_of_the_urdf_where_our_kinematics_does(cell, text):
    pin = pytest.importorskip("pinocchio", reason="needs the package pin")
    model = pin.buildModelFromXML(text)
    data = model.createData()
    for q in np.random.default_rng(4).uniform(-1.5, 1.5, (5, 6)):
        pin.framesForwardKinematics(model, data, q)
        ours = forward(cell.arm, cell.mount, q)
        for name, pose in (("flange", ours.flange), ("tcp", ours.tool), ("workpiece", cell.workpiece.pose)):
            placed = data.oMf[model.getFrameId(name)]
            np.testing.assert_allclose(placed.translation, pose.position, atol=1e-8)
            np.testing.assert_allclose(placed.rotation, pose.rotation, atol=1e-8)


def test_the_solids_of_every_link_are_closed_and_have_a_known_colour_and_the_tool_ends_in_the_tip(cell, text):
    root = ET.fromstring(text)
    assert {shape.tag for geometry in root.iter("geometry") for shape in geometry} == {"box", "cylinder"}
    known = {material.get("name") for material in root.findall("material")}
    assert {material.get("name") for material in root.findall(".//visual/material")} <= known
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
    reference = cell.target()
    model = robot_model(cell, SimpleNamespace(reference=reference, name="original"))
    np.testing.assert_allclose(model.joints[0], commanded_joints(cell, reference)[0], atol=1e-9)
    assert np.abs(model.joints[0] - cell.posture).max() > 1e-4  # [rad], of the sag
    assert model.time[-1] == pytest.approx(reference.duration_ns * 1e-9)


# --- The layout files in config: every panel that is placed is described, every path exists in its message ---
KNOWN = {f"/{name}": kind for name, kind in TYPES.items()} | OUTPUTS
KNOWN |= {"/diagnostics": "diagnostic_msgs/msg/DiagnosticArray"}
#: the names that Lichtblick's code gives to the settings of its panels (RendererConfig, PlotConfig, ...)
PANELS = {
    "3D": {"cameraState", "followMode", "followTf", "scene", "transforms", "topics", "layers", "publish", "imageMode"},
    "Plot": {"foxglovePanelTitle", "lichtblickPanelTitle", "paths", "showLegend", "legendDisplay", "isSynced",
             "xAxisVal", "showPlotValuesInLegend", "showXAxisLabels", "showYAxisLabels", "sidebarDimension"},
    "DiagnosticSummary": {"minLevel", "pinnedIds", "topicToRender", "hardwareIdFilter", "sortByLevel"},
}  # fmt: skip


def has_number(kind: str, fields: list[str]) -> bool:
    """Whether a path of field names, some with an index, leads to a number in a message."""
    from rosbags.interfaces import Nodetype

    name, indexed = re.fullmatch(r"(\w+)(\[\d+\])?", fields[0]).groups()
    about = dict(store_of(kind).fielddefs[kind][1]).get(name)
    if about is None:
        return False
    if about[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        assert indexed, fields
        about = about[1][0]
    if about[0] == Nodetype.NAME:
        return len(fields) > 1 and has_number(about[1], fields[1:])
    return len(fields) == 1 and about[1][0].startswith(("float", "int", "uint"))


def placed(node) -> list[str]:
    if isinstance(node, str):
        return [node]
    assert set(node) == {"direction", "splitPercentage", "first", "second"}
    assert node["direction"] in ("row", "column") and 0 < node["splitPercentage"] < 100
    return placed(node["first"]) + placed(node["second"])


def test_the_layout_of_the_3d_viewers_places_what_it_describes_and_plots_numbers():
    layout = json.loads(find_file("viewer_layout.json").read_text())
    assert {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"} == set(layout)
    assert sorted(placed(layout["layout"])) == sorted(layout["configById"])
    for name, panel in layout["configById"].items():
        assert set(panel) <= PANELS[name.split("!")[0]], name
        for topic in panel.get("topics", {}):
            assert topic in KNOWN, topic
    paths = [path["value"] for panel in layout["configById"].values() for path in panel.get("paths", [])]
    assert len(paths) == 12
    for path in paths:
        topic, *fields = path.split(".")
        assert has_number(KNOWN[topic], fields), path


def test_every_curve_of_plotjuggler_is_a_number_of_its_message():
    root = ET.parse(find_file("plotjuggler_layout.xml")).getroot()
    assert root.tag == "root" and root.find("tabbed_widget/Tab/Container/DockSplitter") is not None
    for splitter in root.iter("DockSplitter"):
        assert int(splitter.get("count")) == len(list(splitter)) == len(splitter.get("sizes").split(";"))
    names = [curve.get("name") for curve in root.iter("curve")]
    assert len(names) == 15
    for name in names:
        _, topic, *fields = name.split("/")
        if topic == "joint_states":  # PlotJuggler names the joints: /joint_states/JOINT/position
            assert fields[0] in [f"joint_{k}" for k in range(1, 7)] and fields[1] == "position"
        else:
            assert has_number(KNOWN[f"/{topic}"], fields), name
