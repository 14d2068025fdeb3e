"""The recipes of the extension guide, each applied to a copy of the package and run there."""

import json
import math
import os
import re
import shutil
import subprocess
import sys
from dataclasses import make_dataclass
from pathlib import Path

import numpy as np
import pytest
from hostile import POSTURE, settings

from kr270_milling.base.errors import ConfigError, ParameterError
from kr270_milling.base.extensions import load_as, registered
from kr270_milling.base.record import parameter
from kr270_milling.physics.compensation import methods
from kr270_milling.physics.cutting import laws
from kr270_milling.physics.cutting.force_law import ForceLaw
from kr270_milling.physics.cutting.laws import Cutting, FractionalLaw, LinearEdgeLaw

ROOT = Path(__file__).resolve().parents[1]
GUIDE = [ROOT / "kr270_milling/guide/contributing" / page for page in ("extending.md", "cam_language.md")]
BLOCK = re.compile(r"^(New file|Change in) `([^`]+)`:\n\n```\w+\n(.*?)^```$", re.MULTILINE | re.DOTALL)
OUTSIDE = "From a package of your own"
MOST_FILES = {
    "A force law": 2, "A compensation method": 2, "A topic": 3, "A robot": 1, "A CAM dialect": 2, "A report column": 2,
    "A conversational program": 2,
}  # fmt: skip


def recipe(title: str) -> list[tuple[str, str, str]]:
    """Kind, file and text of each edit of a section of the guide."""
    sections = re.split(r"^## ", "".join(page.read_text(encoding="utf-8") for page in GUIDE), flags=re.MULTILINE)
    (section,) = (text for text in sections if text.startswith(title + "\n"))
    return BLOCK.findall(section)


def python(folder: Path, code: str, *words: str) -> str:
    """The output of a program that imports from a folder first."""
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    command = [sys.executable, "-c", code, *words]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout


# --- all recipes in one copy; its sweep was compiled before the force law existed ---
K_C, M_C, RATIO = 700e6, 0.25, 0.35  # k_c1.1 [N/m^2], m_c, k_r: ordinary aluminium
FEEDS = np.array([0.04e-3, 0.08e-3, 0.12e-3, 0.16e-3, 0.2e-3])  # [m]
KIENZLE = settings(
    "cutting.law=kienzle", f"cutting.kienzle.specific_force_n_per_mm2={K_C / 1e6}", f"cutting.kienzle.exponent={M_C}",
    f"cutting.kienzle.radial_ratio={RATIO}",
)  # fmt: skip
SHORT = settings("path.length_mm=16", "stock.grid_step_um=40", "stock.max_mm=[16,12,0]")
#: of the simulated robots only the force coefficients differ
SURE = settings("uncertainty.servo_frequency_hz=[]", "uncertainty.end_share=[]", *(f"uncertainty.{name}=0" for name in (
    "joint_compliance", "tool_wear", "base_compliance_urad_per_n_m", "tool_stick_out", "tool_compliance",
    "damping_ratio", "frequency", "reference_inertia", "repeatability_um", "pose_noise_um", "backlash",
    "servo_delay_ms", "joining", "placement_mm",
)))  # fmt: skip
COMMANDS = {
    "stability": ["stability", "paper.yaml", *KIENZLE, *SHORT, "--speeds", "8000:8000/1", "--json"],
    "half": ["compensate", "paper.yaml", *KIENZLE, *SHORT, *SURE, "--method", "half", "--verdict", "3", "--out", "half",
             "--json"],
    "forces": ["identify", "forces", "cuts.csv", "--teeth", "4", "--diameter-mm", "20", "--law", "kienzle", "--out",
               "fitted", "--json"],
    "my robot": ["stiffness", "my_robot.yaml", POSTURE, "--json"],
    "shipped robot": ["stiffness", "kr270_2.yaml", POSTURE, "--json"],
}  # fmt: skip
PROGRAM = """
import contextlib, io, json, math, sys
from pathlib import Path

import numpy as np

from kr270_milling import read_cell
from kr270_milling.base.errors import InputError
from kr270_milling.base.samples import WrenchSample
from kr270_milling.cell.models import path_of
from kr270_milling.cli import main
from kr270_milling.exchange.robot import RobotProtocol
from kr270_milling.path.cam.readers import read_toolpath
from kr270_milling.physics.cutting import LAWS, Cut, Cutting, EngagementCut, Stock, Tool
from kr270_milling.recordings.messages.codec import to_bytes
from kr270_milling.recordings.messages.topics import published_by, topic_table

answers = {}
for name, words in json.loads(sys.argv[1]).items():
    with contextlib.redirect_stdout(io.StringIO()) as text:
        assert main(words) == 0, words
    answers[name] = text.getvalue()

# a slot by the force law, with teeth and with mean forces
law = Cutting("kienzle", kienzle=LAWS["kienzle"](*json.loads(sys.argv[2])))
answers["slots"] = []
for kind, grid_step in ((Cut, 1e-5), (EngagementCut, 1e-4)):
    stock = Stock(min=np.array([0.0, -0.012, -5e-3]), max=np.array([0.03, 0.012, 0.0]), grid_step=grid_step)
    cut = kind(Tool(diameter=0.02, teeth=4, spindle_speed=800.0), law, stock, math.radians(1.0))
    x, turn = np.array([-0.011, 0.0, -1e-3]), np.array([4e-4, 0.0, 0.0])
    forces = [cut.sweep(x + n * turn, x + (n + 1) * turn, 360 * n, 360)[:2] for n in range(64)]
    answers["slots"].append(np.mean(forces[-4:], axis=0).tolist())

# the topic is in the table on the page, and its protocol publishes the record
assert "rigid_pose" in {topic.name for topic in published_by("compliant_robot")}
assert topic_table() in Path("kr270_milling/guide/nodes.md").read_text(encoding="utf-8")
cell = read_cell("paper.yaml", "path.length_mm=4")
robot = RobotProtocol(cell)
robot.reference = path_of(cell).target
robot.start()
published = dict(robot.wrench(WrenchSample(0, "workpiece", np.zeros(6))))
assert np.allclose(published["rigid_pose"].position, path_of(cell).target.position[0])
assert to_bytes(published["rigid_pose"])

# the reader
path = read_toolpath("path.xyz")
assert path.length == 0.01 and path.feed[1] == 0.01 and path.rapid.tolist() == [True, False]
try:
    read_toolpath("bad.xyz")
except InputError as error:
    answers["bad.xyz"] = str(error)
path = read_toolpath("slot.conv")
assert path.program.tool == "T1" and path.rapid.tolist() == [True, False, False, True]
assert np.allclose(path.position[2:], [(0.015, 0, -5e-4), (0.015, 0, 0.01)]) and math.isclose(path.feed[2], 2 / 60)
assert math.isclose(path.spindle_speed[2], 800 * math.pi / 3)
try:
    read_toolpath("bad.conv")
except InputError as error:
    answers["bad.conv"] = str(error)
print(json.dumps(answers))
"""


def kienzle_slot(feed: np.ndarray) -> np.ndarray:
    """Mean F_x, F_y (n, 2) [N] of a slot by [Kienzle1952], 4 teeth, 1 mm deep, h = f cos(phi): closed integrals.

    int cos^(2 - m) = sqrt(pi) G(3/2 - m/2) / G(2 - m/2), int cos^(1 - m) sin = 0 over the half turn of a slot.
    """
    integral = math.sqrt(math.pi) * math.gamma(1.5 - M_C / 2) / math.gamma(2 - M_C / 2)
    tangential = 4 * 1e-3 / (2 * math.pi) * K_C * feed * (feed / 1e-3) ** -M_C * integral
    return np.stack([-RATIO * tangential, tangential], -1)


@pytest.fixture(scope="module")
def copy(tmp_path_factory) -> Path:
    """The directory of a copy of the package with all recipes."""
    copy = tmp_path_factory.mktemp("copy")
    for name in ("kr270_milling", "config"):  # with compiled code, so a change would be seen
        shutil.copytree(ROOT / name, copy / name)
    shutil.copy(ROOT / "package.xml", copy)
    for title, most in MOST_FILES.items():
        edits = recipe(title)
        assert 1 <= len({name for _, name, _ in edits}) <= most, title
        for kind, name, text in edits:
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


@pytest.fixture(scope="module")
def answers(copy) -> dict:
    """What the commands print in the copy, and what the program returns."""
    cuts = zip(FEEDS, kienzle_slot(FEEDS), strict=True)
    rows = [f"{1e3 * feed:.6g},1,20,slot,{fx:.12g},{fy:.12g}" for feed, (fx, fy) in cuts]
    (copy / "cuts.csv").write_text("\n".join(["feed_per_tooth_mm,depth_mm,width_mm,mode,fx_n,fy_n", *rows]) + "\n")
    (copy / "path.xyz").write_text("0 0 0 600\n10 0 0 600\n")
    (copy / "bad.xyz").write_text("0 0 0 600\n10 0 0\n")
    program = re.search(r"```\n(0 BEGIN.*?)```", GUIDE[1].read_text(encoding="utf-8"), re.DOTALL)[1]
    (copy / "slot.conv").write_text(program)
    (copy / "bad.conv").write_text(program.replace("L X+15", "C X+15"))
    out = json.loads(python(copy, PROGRAM, json.dumps(COMMANDS), json.dumps([K_C, M_C, RATIO])))
    return {name: json.loads(text) if name in COMMANDS else text for name, text in out.items()}


def test_a_slot_by_the_force_law_has_the_force_of_the_closed_form(answers):
    """1 % as the other slots of the book, with teeth and with mean forces."""
    expected = kienzle_slot(np.array([0.1e-3]))
    np.testing.assert_allclose(answers["slots"], expected.repeat(2, 0), atol=0.01 * np.abs(expected).max())


def test_commands_take_law_method_robot_reader_and_column_and_the_verdict_scatters_the_coefficients(answers, copy):
    assert answers["stability"] and answers["half"]["method"] == "half"
    verdict = answers["half"]["verdict"]
    assert verdict["samples"] == 3 and len(set(verdict["compensated_um"])) == 3
    assert (copy / "half" / "reference_half.csv").is_file()
    fitted = [answers["forces"]["kienzle"][key] for key in ("specific_force_n_per_mm2", "exponent", "radial_ratio")]
    assert fitted == pytest.approx([700.0, M_C, RATIO], rel=1e-3)
    text = next((copy / "fitted").glob("*.yaml")).read_text(encoding="utf-8")
    assert "law: kienzle" in text and "force_coefficients" in text
    assert answers["my robot"]["compliance"] != answers["shipped robot"]["compliance"]
    assert "line 2" in answers["bad.xyz"]
    assert "line 5" in answers["bad.conv"] and "no straight move" in answers["bad.conv"]
    assert all(row["mean_size_um"] > 0 for row in answers["half"]["passes"])


# --- the same law, method and reader in a package of somebody else, beside the package under test ---
def test_a_package_of_somebody_else_adds_law_method_and_reader_to_every_command(tmp_path_factory):
    source, installed = tmp_path_factory.mktemp("my_milling"), tmp_path_factory.mktemp("installed")
    (source / "my_milling").mkdir()
    (source / "my_milling/__init__.py").touch()
    for title in ("A force law", "A compensation method", "A CAM dialect"):
        ((name, text),) = ((name, text) for kind, name, text in recipe(title) if kind == "New file")
        (source / "my_milling" / Path(name).name).write_text(text, encoding="utf-8")
    ((_, name, text),) = recipe(OUTSIDE)
    (source / name).write_text(text, encoding="utf-8")
    install = ["install", "-q", "--no-deps", "--no-build-isolation", "--target", str(installed), str(source)]
    subprocess.run([sys.executable, "-m", "pip", *install], check=True, timeout=300)

    (installed / "part.xyz").write_text("-14 0 2 6000\n-14 0 -0.5 600\n20 0 -0.5 4000\n20 0 2 6000\n")
    part = settings(f"path.file={installed / 'part.xyz'}", "stock.min_mm=[0,-14,-10]", "stock.max_mm=[20,14,0]",
                    "stock.grid_step_um=50", "part.tolerance_um=200")  # fmt: skip
    order = ("--method", "half", "--verdict", "0", "--out", "out", "--json")
    code = "import sys; from kr270_milling.cli import main; sys.exit(main(sys.argv[1:]))"
    result = json.loads(python(installed, code, "compensate", "paper.yaml", *KIENZLE, *part, *order))
    assert result["method"] == "half"
    original, revised = (row["max_deviation_um"] for row in result["passes"])
    assert 0.3 * original < revised < 0.7 * original  # half of the deviation is left
    assert {".src", ".html"} <= {file.suffix for file in (installed / "out").rglob("*")}


MINE = """
from dataclasses import dataclass
from kr270_milling.base.record import parameter
from kr270_milling.physics.cutting.force_law import ForceLaw
from kr270_milling.physics.cutting.laws import FractionalLaw, LinearEdgeLaw
class Other:
    name = "other"
    def revise(self, task): ...
@dataclass(frozen=True, eq=False)
class Short(FractionalLaw):
    axial_names = ()
    start = (1.0,)
"""


@pytest.mark.parametrize(("line", "sentence"), [
    ("[kr270_milling.force_laws]\nlinear_edge = json:loads", "this name is taken"),
    ("[kr270_milling.force_laws]\nmine = no_such_module:Law", "cannot be imported (ModuleNotFoundError"),
    ("[kr270_milling.force_laws]\nmine = broken:Law", "cannot be imported (NameError: name 'nothing' is not defined)"),
    ("[kr270_milling.methods]\nmine = json:loads", "json:loads is no class with the function revise"),
    ("[kr270_milling.methods]\nmine = mine:Other", "the method is named other; give both the same name"),
    ("[kr270_milling.force_laws]\nmine = mine:Short", "start and searched must have 5 entries"),
])  # fmt: skip
def test_an_entry_point_that_cannot_be_used_is_named_in_one_sentence(tmp_path, monkeypatch, line, sentence):
    (tmp_path / "mine-1.0.dist-info").mkdir()
    (tmp_path / "mine.py").write_text(MINE)
    (tmp_path / "broken.py").write_text("nothing")
    (tmp_path / "mine-1.0.dist-info/METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (tmp_path / "mine-1.0.dist-info/entry_points.txt").write_text(line + "\n")
    if "broken" in line:  # as a user sees it
        environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
        command = [sys.executable, "-m", "kr270_milling.cli", "compensate", "paper.yaml"]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
        assert done.returncode == 2 and " mine: " in done.stderr and sentence in done.stderr
        assert "Traceback" not in done.stderr
        return
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    with pytest.raises(ConfigError, match="mine") as caught:
        methods._plugged.__wrapped__()
        for point in registered("force_laws", laws.LAWS):
            laws.refuse_fault(point.name, load_as(point, laws._is_law, "subclass of ForceLaw"))
    assert sentence in str(caught.value)


@pytest.mark.parametrize(("members", "sentence"), [
    ({"scattered": ("stifness",)}, "have stifness, which is no coefficient"),
    ({"force": staticmethod(lambda h, c: (0.0, 0.0, 0.0))}, "force must take h and the coefficients, at most 12"),
])  # fmt: skip
def test_a_force_law_that_cannot_be_used_has_a_fault(members, sentence):
    assert sentence in type("Mine", (FractionalLaw,), members).fault()


def test_a_force_that_raises_is_a_fault_and_one_that_cannot_be_compiled_is_refused_in_one_sentence():
    """Compiled code prints an error that it raises and continues with a force of 0."""

    def raises(h, slope):
        assert h < 1.0
        return slope * h, 0.0, 0.0

    fields = [("slope", float, parameter(1.0, unit="n_per_mm2", text="slope"))]
    about = {"scattered": ("slope",), "start": (1.0,), "searched": ((0.0, 1.0),)}
    for force, fault in ((raises, "force must not raise"), (lambda h, slope: (slope * h, 0.0), "")):
        namespace = {**about, "force": staticmethod(force)}
        law = make_dataclass("Mine", fields, bases=(ForceLaw,), namespace=namespace, frozen=True, eq=False)
        assert law.fault().startswith(fault) and bool(law.fault()) == bool(fault)
    with pytest.raises(ConfigError, match="force law Mine: force: cannot be compiled .No conversion from UniTuple"):
        law.address()


@pytest.mark.parametrize(("force", "sentence"), [
    (lambda h, k: (-k * h, 0.0, 0.0), "F_t, F_r, F_a are -0.01, 0, 0 N/mm at a chip of 0.01 um"),
    (lambda h, k: (k * h * (1.0 - h / 0.9e-3), 0.0, 0.0), "N/mm at a chip of 1e+03 um"),
    (lambda h, k: (k, math.inf, 0.0), "F_t, F_r, F_a are 1e+06, inf, 0 N/mm"),
    (lambda h, k: (k / (h - h), 0.0, 0.0), "float division by zero at a chip of 0.01 um"),
])  # fmt: skip
def test_a_law_whose_tangential_force_is_negative_or_not_finite_is_refused_in_one_sentence(force, sentence):
    fields = [("slope", float, parameter(1e9, unit="n_per_mm2", text="slope"))]
    law = make_dataclass("Mine", fields, bases=(LinearEdgeLaw,), namespace={"force": staticmethod(force)}, frozen=True,
                         eq=False)  # fmt: skip
    law.arguments = property(lambda self: np.array([self.slope]))
    with pytest.raises(ParameterError, match="law is 'linear_edge'") as caught:
        Cutting(law="linear_edge", linear_edge=law(1.0, 1.0, 1.0, 1.0))
    assert sentence in str(caught.value)


def test_a_force_law_without_a_force_or_with_an_unknown_unit_has_a_fault():
    assert "no attribute force" in type("Mine", (ForceLaw,), {"scattered": ()}).fault()
    fields = [("slope", float, parameter(1.0, unit="n_per_mm3", text="slope"))]
    about = {"scattered": (), "force": staticmethod(lambda h, slope: (0.0, 0.0, 0.0))}
    law = make_dataclass("Mine", fields, bases=(ForceLaw,), namespace=about, frozen=True, eq=False)
    assert "'n_per_mm3' is not one of m, mm" in law.fault()
