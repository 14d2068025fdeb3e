"""The layout files in config: every panel that is placed is described, every path exists in its message."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

from kr270_milling.exchange.replay.inputs import TYPES
from kr270_milling.exchange.scene import OUTPUTS
from kr270_milling.recordings.messages.definitions import store_of

CONFIG = Path(__file__).resolve().parents[3] / "config"
KNOWN = (
    {f"/{name}": kind for name, kind in TYPES.items()}
    | OUTPUTS
    | {"/diagnostics": "diagnostic_msgs/msg/DiagnosticArray"}
)
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
    layout = json.loads((CONFIG / "viewer_layout.json").read_text())
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
    root = ET.parse(CONFIG / "plotjuggler_layout.xml").getroot()
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
