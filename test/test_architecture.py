"""The borders between the folders, kept by reading the source: who imports whom, and what no file may hold."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "kr270_milling"
PHYSICS = ("robot", "cutting", "trajectory", "simulation", "compensation", "recording", "report")
#: lower layers may not import higher ones, nor siblings each other, but for the pairs in ALLOWED (design)
LAYER = {
    "errors": 0, "config_file": 0, "config": 0, "frames": 0,
    "robot": 1, "cutting": 1, "trajectory": 1,
    "simulation": 2, "compensation": 2, "recording": 2,
}  # fmt: skip
BASE = {"errors", "config_file", "config", "frames"}
ALLOWED = {("compensation", "simulation")}


def modules() -> list[str]:
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found.append(".".join(parts[:-1] if parts[-1] == "__init__" else parts))
    return found


def source_of(module: str) -> Path:
    path = ROOT.joinpath(*module.split("."))
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


MODULES = modules()


@cache
def imports(module: str, everywhere: bool = True) -> frozenset[str]:
    """Absolute names that a module imports; everywhere: also inside functions."""
    tree, names = ast.parse(source_of(module).read_text()), set()
    for node in ast.walk(tree) if everywhere else _run_at_import(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module} imports relatively"
            found = {f"{node.module}.{alias.name}" for alias in node.names}
            names |= found if found <= set(MODULES) else found | {node.module}  # else only its submodules
    return frozenset(names)


def _run_at_import(tree):
    """Nodes outside of functions and of ``if TYPE_CHECKING``."""
    waiting = list(tree.body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            continue
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        yield node
        waiting.extend(ast.iter_child_nodes(node))


def part(module: str) -> str:
    """The folder or top module that a name of the package belongs to."""
    return module.split(".")[1] if "." in module else ""


def own(names) -> set[str]:
    return {n for n in names if n.startswith("kr270_milling.")}


@pytest.mark.parametrize("module", [m for m in MODULES if part(m) in LAYER])
def test_imports_run_one_way(module):
    """{simulation, compensation, recording} -> {robot, cutting, trajectory} -> {config, errors, frames}."""
    here = part(module)
    for name in own(imports(module)):
        there = part(name)
        if (
            name == "kr270_milling.__version__"
            or there == here
            or there in BASE
            and here in BASE
            or (here, there) in ALLOWED
        ):
            continue
        assert there in LAYER, f"{module} imports {name} from above"
        assert LAYER[there] < LAYER[here], f"{module} imports {name} from beside or above"


@pytest.mark.parametrize("module", [m for m in MODULES if part(m) not in ("nodes", "ros", "commands", "cli")])
def test_only_nodes_and_commands_know_ros(module):
    ros = ("rclpy", "rcl_interfaces", "builtin_interfaces", "rosgraph_msgs", "rosidl", "lifecycle_msgs", "rosbag2",
           "ament_index_python", "kr270_milling.ros", "kr270_milling.nodes")  # fmt: skip
    for name in imports(module):
        assert not name.startswith(ros) and not re.match(r"\w+_msgs(\.|$)", name), f"{module} imports {name}"


def test_nobody_below_imports_the_command_line():
    for module in MODULES:
        if part(module) not in ("commands", "cli"):
            for name in own(imports(module)):
                assert part(name) not in ("commands", "cli"), f"{module} imports {name}"


def test_physics_imports_where_ros_is_not_installed():
    """Every module below nodes and ros, in a process that has no ROS."""
    wanted = [m for m in MODULES if part(m) in PHYSICS or part(m) in ("passes", "replay", "cell", "frames", "config")]
    code = f"""
import importlib, sys
class NoRos:
    def find_spec(self, name, path=None, target=None):
        top = name.split(".")[0]
        if top in ("rclpy", "rcl_interfaces", "rosidl_runtime_py") or top.endswith("_msgs"):
            raise ModuleNotFoundError(f"no ROS here: {{name}}", name=name)
sys.meta_path.insert(0, NoRos())
for name in {wanted!r}:
    importlib.import_module(name)
assert not any(m.split(".")[0] == "rclpy" for m in sys.modules)
"""
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert ran.returncode == 0, ran.stderr[-2000:]


def test_there_is_no_circle_of_imports():
    """Of those that run when a module is imported."""
    known = set(MODULES)
    graph = {m: own(imports(m, everywhere=False)) & known - {m} for m in MODULES}
    done, path = set(), []

    def visit(module):
        if module in path:
            pytest.fail(" -> ".join([*path[path.index(module) :], module]))
        if module in done:
            return
        path.append(module)
        for name in sorted(graph[module]):
            visit(name)
        path.pop()
        done.add(module)

    for module in MODULES:
        visit(module)


@pytest.mark.parametrize("module", [m for m in MODULES if part(m) not in ("nodes", "ros")])
def test_every_name_in_all_exists_once(module):
    found = importlib.import_module(module)
    names = getattr(found, "__all__", [])
    assert len(set(names)) == len(names)
    for name in names:
        assert hasattr(found, name), f"{module}.{name}"


# --- files ---


def tracked() -> list[Path]:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("no git checkout")
    return [ROOT / name for name in listed.stdout.split("\0") if name and (ROOT / name).is_file()]


def texts():
    for path in tracked():
        content = path.read_bytes()
        if b"\0" not in content:
            yield path, content.decode("utf-8")


def test_no_file_is_longer_than_300_lines():
    long = {str(p.relative_to(ROOT)): t.count("\n") for p, t in texts() if p.suffix == ".py" and t.count("\n") > 300}
    assert not long


#: pieces, so that this file does not hold what it looks for
FORBIDDEN = ("/wo" + "rk/", "/ho" + "me/", "/Us" + "ers/", "/ro" + "ot/", "C:" + "\\", "../sh" + "ared")


def test_no_file_names_a_place_of_one_machine():
    for path, text in texts():
        for word in FORBIDDEN:
            assert word not in text, f"{path.relative_to(ROOT)} holds {word}"


#: calls that make code out of what a file says
@pytest.mark.parametrize("call", ["eval", "exec", "pickle.load", "pickle.loads", "yaml.unsafe_load", "os.system"])
def test_nothing_that_was_read_is_executed(call):
    for module in MODULES:
        for node in ast.walk(ast.parse(source_of(module).read_text())):
            if isinstance(node, ast.Call):
                assert ast.unparse(node.func) != call, f"{module}, line {node.lineno}"


def test_no_input_is_checked_by_assert_and_no_error_is_swallowed_whole():
    for module in MODULES:
        for node in ast.walk(ast.parse(source_of(module).read_text())):
            assert not isinstance(node, ast.Assert), f"{module}, line {node.lineno}"
            if isinstance(node, ast.ExceptHandler):
                assert node.type is not None, f"{module}, line {node.lineno}: bare except"


def test_every_file_postpones_its_annotations_or_has_none():
    """Python 3.10 is the oldest that it runs on."""
    for module in MODULES:
        text = source_of(module).read_text()
        annotated = any(
            isinstance(node, (ast.FunctionDef, ast.AnnAssign))
            and (getattr(node, "returns", None) or isinstance(node, ast.AnnAssign))
            for node in ast.walk(ast.parse(text))
        )
        assert not annotated or "from __future__ import annotations" in text, module
