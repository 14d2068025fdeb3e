"""What neither ruff nor the import contracts of ``pyproject.toml`` can say; the gate checks both."""

import ast
import pkgutil
import subprocess
import sys
from pathlib import Path

import mutations
import pytest

import kr270_milling

ROOT = Path(__file__).resolve().parent.parent


def test_everything_but_the_nodes_imports_where_ros_is_not_installed():
    modules = pkgutil.walk_packages(kr270_milling.__path__, "kr270_milling.")
    wanted = [m.name for m in modules if m.name.split(".")[1] != "live"]  # the folder that may import ROS
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
"""
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert len(wanted) > 50 and ran.returncode == 0, ran.stderr[-2000:]


@pytest.mark.parametrize("file", sorted(mutations.TESTS))
def test_mutations_fit_the_code_that_they_change(file):
    """``python test/mutations.py`` runs the tests with each mutation, which takes long."""
    text = (ROOT / "kr270_milling" / file).read_text(encoding="utf-8")
    for equation, changed, pattern in mutations.MUTATIONS:
        assert changed != file or text.count(mutations.texts(pattern)[0]) == 1, (equation, pattern)
    assert all(list(ROOT.glob(f"test/**/test_{name}.py")) for name in mutations.TESTS[file])


def test_no_gufunc_is_compiled():
    """Two processes that compile a gufunc of numba at a time leave a cache with which all later processes crash."""
    names = [path.name for path in (ROOT / "kr270_milling").rglob("*.py") if "import guvec" in path.read_text("utf-8")]
    assert not names


#: pieces, so that this file does not hold what it looks for
FORBIDDEN = ("/wo" + "rk/", "/ho" + "me/", "/Us" + "ers/", "/ro" + "ot/", "../sh" + "ared")


def test_no_file_names_a_place_of_one_machine():
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("no git checkout")
    for path in (ROOT / name for name in listed.stdout.split("\0") if name):
        content = path.read_bytes() if path.is_file() else b""
        assert not [word for word in FORBIDDEN if word.encode() in content], path.relative_to(ROOT)


def test_each_class_and_function_name_of_the_package_has_one_meaning():
    """The functions of ``api`` have the names of what they wrap; names with an underscore belong to their file."""
    places: dict[str, list[str]] = {}
    for path in sorted((ROOT / "kr270_milling").rglob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(path.name)
    several = {name: files for name, files in places.items() if len([f for f in files if f != "api.py"]) > 1}
    assert not several, several
