"""The recipes of the extension guide, each applied to a copy of the package and run there."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
GUIDE = ROOT / "kr270_milling/guide/extending.md"
BLOCK = re.compile(r"^(New file|Change in) `([^`]+)`:\n\n```\w+\n(.*?)^```$", re.MULTILINE | re.DOTALL)
MOST_FILES = {
    "A force law": 2, "A compensation method": 2, "A topic": 3, "A robot": 1, "A CAM dialect": 2, "A report column": 2,
}  # fmt: skip
SHORT = ("path.length_mm=4", "stock.grid_step_um=20", "stock.max_mm=[4,12,0]")


def recipe(title: str) -> list[tuple[str, str, str]]:
    """Kind, file and text of each edit of a section of the guide."""
    sections = re.split(r"^## ", GUIDE.read_text(encoding="utf-8"), flags=re.MULTILINE)
    (section,) = (text for text in sections if text.startswith(title + "\n"))
    return BLOCK.findall(section)


@pytest.fixture
def extended(tmp_path):
    """Return a function that applies a recipe to a copy of the package and returns the directory of the copy."""

    def apply(title: str) -> Path:
        shutil.copytree(ROOT / "kr270_milling", tmp_path / "kr270_milling")  # with compiled code
        shutil.copytree(ROOT / "config", tmp_path / "config")
        shutil.copy(ROOT / "package.xml", tmp_path)
        for kind, name, text in recipe(title):
            file = tmp_path / name
            if kind == "New file":
                assert not file.exists()
                file.write_text(text, encoding="utf-8")
                continue
            lines = text.splitlines(keepends=True)
            before = "".join(line[1:] for line in lines if line[0] in " -")
            after = "".join(line[1:] for line in lines if line[0] in " +")
            whole = file.read_text(encoding="utf-8")
            assert whole.count(before) == 1, f"{name} has these lines {whole.count(before)} times:\n{before}"
            file.write_text(whole.replace(before, after), encoding="utf-8")
        return tmp_path

    return apply


def python(copy: Path, code: str, *words: str) -> str:
    """The output of a program that imports the copy."""
    environment = {**os.environ, "PYTHONPATH": str(copy)}
    done = subprocess.run(
        [sys.executable, "-c", code, *words], cwd=copy, env=environment, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def command(copy: Path, *words: str, json_too: bool = True):
    code = "import sys; from kr270_milling.cli import main; sys.exit(main(sys.argv[1:]))"
    out = python(copy, code, *words, *(["--json"] if json_too else []))
    return json.loads(out) if json_too else out


def settings(*more: str) -> list[str]:
    return [word for setting in (*SHORT, *more) for word in ("--set", setting)]


@pytest.mark.parametrize("title", MOST_FILES)
def test_a_recipe_needs_no_more_files_than_promised(title):
    files = {name for _, name, _ in recipe(title)}
    assert 1 <= len(files) <= MOST_FILES[title]


def test_a_force_law_of_the_guide_simulates_a_pass(extended):
    law = ("specific_force_n_per_mm2=700", "exponent=0.25", "radial_ratio=0.35")
    chosen = ["cutting.law=kienzle", *(f"cutting.kienzle.{text}" for text in law)]
    copy = extended("A force law")
    assert command(copy, "simulate", "paper.yaml", *settings(*chosen))["removed_area_mm2"] > 0


def test_a_compensation_method_of_the_guide_compensates_a_short_cut(extended):
    copy = extended("A compensation method")
    words = ("compensate", "paper.yaml", "--method", "half", "--no-verdict", "--out", str(copy / "out"), *settings())
    assert command(copy, *words)["method"] == "half"


def test_a_topic_of_the_guide_is_in_the_table_on_the_page_and_published_by_its_protocol(extended):
    code = """
from pathlib import Path

import numpy as np

from kr270_milling import read_cell
from kr270_milling.base.samples import WrenchSample
from kr270_milling.exchange.robot import RobotProtocol
from kr270_milling.recordings.messages.codec import to_bytes
from kr270_milling.recordings.messages.topics import published_by, topic_table

assert "rigid_pose" in {topic.name for topic in published_by("compliant_robot")}
assert topic_table() in Path("kr270_milling/live/nodes/README.md").read_text(encoding="utf-8")
cell = read_cell("paper.yaml", "path.length_mm=4")
robot = RobotProtocol(cell)
robot.reference = cell.target()
robot.start()
published = dict(robot.wrench(WrenchSample(0, "workpiece", np.zeros(6))))
assert np.allclose(published["rigid_pose"].position, cell.target().position[0])
assert to_bytes(published["rigid_pose"])
"""
    python(extended("A topic"), code)


def test_a_robot_of_the_guide_has_a_stiffness(extended):
    copy = extended("A robot")
    words = ("stiffness", "my_robot.yaml", "--joints-deg", "90,-50,120,180,25,180")
    ours, shipped = command(copy, *words), command(copy, "stiffness", "kr270_2.yaml", *words[2:])
    assert ours["compliance"] != shipped["compliance"]


def test_a_cam_dialect_of_the_guide_is_read_with_the_line_of_an_error(extended, tmp_path):
    good, bad = tmp_path / "path.xyz", tmp_path / "bad.xyz"
    good.write_text("0 0 0 600\n10 0 0 600\n", encoding="utf-8")
    bad.write_text("0 0 0 600\n10 0 0\n", encoding="utf-8")
    code = """
from kr270_milling.base.errors import InputError
from kr270_milling.path.cam.readers import read_toolpath

path = read_toolpath("path.xyz")
assert path.length == 0.01 and path.feed[1] == 0.01 and path.rapid.tolist() == [True, False]
try:
    read_toolpath("bad.xyz")
except InputError as error:
    print(error)
"""
    assert "line 2" in python(extended("A CAM dialect"), code)


def test_a_report_column_of_the_guide_is_in_the_table_and_in_the_json(extended):
    copy = extended("A report column")
    words = ("compensate", "paper.yaml", "--no-verdict", "--out", str(copy / "out"), *settings())
    assert all(row["mean_size_mm"] > 0 for row in command(copy, *words)["passes"])
    assert re.search(r"\bpass\b.*\bstatic\b.*\bmax\b.*\bmean size\b", command(copy, *words, json_too=False))
