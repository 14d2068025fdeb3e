"""The recipes of the extension guide, each applied to a copy of the package and run there."""

from __future__ import annotations

import functools
import json
import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
GUIDE = ROOT / "kr270_milling/guide/extending.md"
BLOCK = re.compile(r"^(New file|Change in) `([^`]+)`:\n\n```\w+\n(.*?)^```$", re.MULTILINE | re.DOTALL)
MOST_FILES = {
    "A force law": 2, "A compensation method": 2, "A topic": 3, "A robot": 1, "A CAM dialect": 2, "A report column": 2,
    "From a package of your own": 1,
}  # fmt: skip
SHORT = ("path.length_mm=4", "stock.grid_step_um=20", "stock.max_mm=[4,12,0]")


def recipe(title: str) -> list[tuple[str, str, str]]:
    """Kind, file and text of each edit of a section of the guide."""
    sections = re.split(r"^## ", GUIDE.read_text(encoding="utf-8"), flags=re.MULTILINE)
    (section,) = (text for text in sections if text.startswith(title + "\n"))
    return BLOCK.findall(section)


@pytest.fixture(scope="module")
def extended(tmp_path_factory):
    """Return a function that applies a recipe to a copy of the package once and returns the directory of the copy."""

    @functools.cache
    def apply(title: str) -> Path:
        copy = tmp_path_factory.mktemp("copy")
        shutil.copytree(ROOT / "kr270_milling", copy / "kr270_milling")  # with compiled code, so a change would be seen
        shutil.copytree(ROOT / "config", copy / "config")
        shutil.copy(ROOT / "package.xml", copy)
        for kind, name, text in recipe(title):
            file = copy / name
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
        return copy

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


# --- a third force law goes through every command; the sweep was compiled before the law existed ---
K_C, M_C, RATIO = 700e6, 0.25, 0.35  # k_c1.1 [N/m^2], m_c, k_r: ordinary aluminium
KIENZLE = (
    "cutting.law=kienzle", f"cutting.kienzle.specific_force_n_per_mm2={K_C / 1e6}", f"cutting.kienzle.exponent={M_C}",
    f"cutting.kienzle.radial_ratio={RATIO}", "path.length_mm=16", "stock.grid_step_um=40", "stock.max_mm=[16,12,0]",
)  # fmt: skip
CUT = """
import math, sys
import numpy as np
from kr270_milling.physics.cutting import LAWS, Cut, Cutting, EngagementCut, Stock, Tool

law = Cutting("kienzle", kienzle=LAWS["kienzle"](*map(float, sys.argv[1:])))
for kind, grid_step in ((Cut, 1e-5), (EngagementCut, 1e-4)):
    stock = Stock(min=np.array([0.0, -0.012, -5e-3]), max=np.array([0.03, 0.012, 0.0]), grid_step=grid_step)
    cut = kind(Tool(diameter=0.02, teeth=4, spindle_speed=800.0), law, stock, math.radians(1.0))
    x, turn = np.array([-0.011, 0.0, -1e-3]), np.array([4e-4, 0.0, 0.0])
    forces = [cut.sweep(x + n * turn, x + (n + 1) * turn, 360 * n, 360)[:2] for n in range(64)]
    print(*np.mean(forces[-4:], axis=0))
"""


def kienzle_slot(feed: np.ndarray) -> np.ndarray:
    """Mean F_x, F_y (n, 2) [N] of a slot by [Kienzle1952], 4 teeth, 1 mm deep, h = f cos(phi): closed integrals.

    int cos^(2 - m) = sqrt(pi) G(3/2 - m/2) / G(2 - m/2), int cos^(1 - m) sin = 0 over the half turn of a slot.
    """
    integral = math.sqrt(math.pi) * math.gamma(1.5 - M_C / 2) / math.gamma(2 - M_C / 2)
    tangential = 4 * 1e-3 / (2 * math.pi) * K_C * feed * (feed / 1e-3) ** -M_C * integral
    return np.stack([-RATIO * tangential, tangential], -1)


def test_a_slot_by_the_force_law_of_the_guide_has_the_force_of_the_closed_form(extended):
    """1 % as the other slots of the book, with teeth and with mean forces."""
    expected = kienzle_slot(np.array([0.1e-3]))[0]
    for line in python(extended("A force law"), CUT, *map(str, (K_C, M_C, RATIO))).splitlines():
        assert [float(word) for word in line.split()] == pytest.approx(expected, abs=0.01 * np.abs(expected).max())


def test_simulate_stability_and_verdict_take_the_force_law_of_the_guide(extended, tmp_path):
    copy, words = extended("A force law"), [word for setting in KIENZLE for word in ("--set", setting)]
    assert command(copy, "simulate", "paper.yaml", *words)["removed_area_mm2"] > 0
    assert command(copy, "stability", "paper.yaml", *words, "--speeds", "8000:8000/1")
    words += ["--method", "spline", "--verdict", "3", "--out", str(tmp_path)]
    verdict = command(copy, "compensate", "paper.yaml", *words)["verdict"]
    assert verdict["samples"] == 3 and len(set(verdict["compensated_um"])) == 3
    assert (tmp_path / "reference_spline.csv").is_file()


def test_identify_forces_fits_the_force_law_of_the_guide(extended, tmp_path):
    feeds = np.array([0.04e-3, 0.08e-3, 0.12e-3, 0.16e-3, 0.2e-3])
    rows = np.column_stack([1e3 * feeds, kienzle_slot(feeds)])
    lines = [f"{feed:.6g},1,20,slot,{fx:.12g},{fy:.12g}" for feed, fx, fy in rows]
    (tmp_path / "cuts.csv").write_text("\n".join(["feed_per_tooth_mm,depth_mm,width_mm,mode,fx_n,fy_n", *lines]) + "\n")
    words = ["--teeth", "4", "--diameter-mm", "20", "--law", "kienzle", "--out", str(tmp_path / "out")]
    found = command(extended("A force law"), "identify", "forces", str(tmp_path / "cuts.csv"), *words)["kienzle"]
    fitted = [found[key] for key in ("specific_force_n_per_mm2", "exponent", "radial_ratio")]
    assert fitted == pytest.approx([700.0, M_C, RATIO], rel=1e-3)
    text = next((tmp_path / "out").glob("*.yaml")).read_text(encoding="utf-8")
    assert "law: kienzle" in text and "force_coefficients" in text


# --- the other recipes ---
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


def test_a_cam_dialect_of_the_guide_is_read_with_the_line_of_an_error(extended):
    copy = extended("A CAM dialect")
    good, bad = copy / "path.xyz", copy / "bad.xyz"
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
    assert "line 2" in python(copy, code)


def test_a_report_column_of_the_guide_is_in_the_table_and_in_the_json(extended):
    copy = extended("A report column")
    words = ("compensate", "paper.yaml", "--no-verdict", "--out", str(copy / "out"), *settings())
    assert all(row["mean_size_mm"] > 0 for row in command(copy, *words)["passes"])
    assert re.search(r"\bpass\b.*\bstatic\b.*\bmax\b.*\bmean size\b", command(copy, *words, json_too=False))


# --- the same law, method and reader in a package of somebody else, beside the package under test ---
@pytest.fixture(scope="module")
def outside(tmp_path_factory):
    """Return the directory in which pip has installed the package of the guide."""
    source, installed = tmp_path_factory.mktemp("my_milling"), tmp_path_factory.mktemp("installed")
    (source / "my_milling").mkdir()
    (source / "my_milling/__init__.py").touch()
    for title in ("A force law", "A compensation method", "A CAM dialect"):
        ((name, text),) = ((name, text) for kind, name, text in recipe(title) if kind == "New file")
        (source / "my_milling" / Path(name).name).write_text(text, encoding="utf-8")
    ((_, name, text),) = recipe("From a package of your own")
    (source / name).write_text(text, encoding="utf-8")
    install = ["install", "-q", "--no-deps", "--no-build-isolation", "--target", str(installed), str(source)]
    subprocess.run([sys.executable, "-m", "pip", *install], check=True, timeout=300)
    return installed


def test_a_package_of_somebody_else_adds_law_method_and_reader_to_every_command(outside, tmp_path):
    (tmp_path / "part.xyz").write_text("-14 0 2 6000\n-14 0 -0.5 600\n20 0 -0.5 4000\n20 0 2 6000\n", encoding="utf-8")
    part = (f"path.file={tmp_path / 'part.xyz'}", "stock.min_mm=[0,-14,-10]", "stock.max_mm=[20,14,0]",
            "stock.grid_step_um=50", "part.tolerance_um=200")  # fmt: skip
    words = [word for setting in (*KIENZLE[:4], *part) for word in ("--set", setting)]
    out = tmp_path / "out"
    order = ("--method", "half", "--verdict", "3", "--out", str(out))
    result = command(outside, "compensate", "paper.yaml", *words, *order)
    assert result["method"] == "half" and result["verdict"]["samples"] == 3
    original, revised = (row["max_deviation_um"] for row in result["passes"])
    assert 0.3 * original < revised < 0.7 * original  # half of the deviation is left
    assert {".src", ".html"} <= {file.suffix for file in out.rglob("*")}


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("[kr270_milling.force_laws]\nlinear_edge = json:loads", "this name is taken"),
        ("[kr270_milling.force_laws]\nmine = no_such_module:Law", "cannot be imported (ModuleNotFoundError"),
        ("[kr270_milling.methods]\nmine = json:loads", "json:loads is no class with the function revise"),
    ],
)
def test_an_entry_point_that_cannot_be_used_is_named_in_one_sentence(tmp_path, line, sentence):
    (tmp_path / "mine-1.0.dist-info").mkdir()
    (tmp_path / "mine-1.0.dist-info/METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (tmp_path / "mine-1.0.dist-info/entry_points.txt").write_text(line + "\n")
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    command = [sys.executable, "-m", "kr270_milling.cli", "compensate", "paper.yaml"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2 and "package mine: entry point" in done.stderr and sentence in done.stderr
    assert "Traceback" not in done.stderr
