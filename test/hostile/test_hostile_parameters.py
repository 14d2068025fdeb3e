"""Each key of a cell with hostile values: refused in one sentence, or an answer of finite numbers."""

import tempfile

import pytest
import yaml
from budget import LONG, budget
from hostile import POSTURE, SHORT, refused, refused_or_sound
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from kr270_milling.base.errors import MillingError
from kr270_milling.base.parameter_file import find_file, merge, override, read_tree
from kr270_milling.base.record import build, flatten
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.keys import keys_of

TREE, _ = override(read_tree(find_file("paper.yaml")), SHORT)
KEYS = sorted(flatten(build(Cell, TREE)))
NAN, INF = float("nan"), float("inf")
WRONG = (NAN, INF, -INF, None, {}, {"a": 1}, [[1.0]], [NAN] * 6, [INF] * 3, 10**40)
NUMBERS = st.one_of(
    st.sampled_from([1e30, -1e30, -1.0, 0.0, 1e-30, 1e6, 1e3, 1e-6, 5e-324, 1.7e308, 0, -1, 1, 2**63, 10**40]),
    st.floats(),
    st.integers(-(10**20), 10**20),
)
TEXTS = st.one_of(
    st.text(max_size=20), st.sampled_from(["x" * 3000, "../../etc/passwd", "1e5", "yes", "!!python/name:os"])
)
VALUES = st.one_of(
    NUMBERS, TEXTS, st.none(), st.booleans(), st.lists(NUMBERS, max_size=8), st.lists(TEXTS, max_size=3), st.just({})
)  # fmt: skip


def tree_with(key: str, value) -> dict:
    """The cell's parameters with one of them replaced."""
    for part in reversed(key.split(".")):
        value = {part: value}
    return {"/**": {"ros__parameters": merge(TREE, value)}}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("cell") / "cell.yaml"


def write(place, key: str, value) -> str:
    place.write_text(yaml.dump(tree_with(key, value), Dumper=getattr(yaml, "CSafeDumper", yaml.SafeDumper)))
    return str(place)


def test_no_key_takes_what_is_no_value_of_its_kind():
    for key in KEYS:
        for value in WRONG:
            if key == "arm.name" and value is None:
                continue
            with pytest.raises(MillingError) as caught:
                build(Cell, tree_with(key, value)["/**"]["ros__parameters"], "cell.yaml")
            text = str(caught.value)
            assert key.rpartition(".")[2] in text and text.isprintable() and len(text) < 600, text


@pytest.mark.parametrize("command", ["check", "compensate"])
@settings(max_examples=budget(100), suppress_health_check=list(HealthCheck), database=None)
@given(key=st.sampled_from(KEYS), value=VALUES)
@example(key="cutting.fractional.stiffness_n_per_m", value=1e30)  # the limit of the depth is 0
def test_any_value_is_refused_or_gives_numbers_that_can_be(command, place, tmp_path, key, value):
    more = ["--verdict", "0", "--out", tempfile.mkdtemp(dir=tmp_path)] if command == "compensate" else []
    refused_or_sound(command, write(place, key, value), *more)


@settings(max_examples=budget(80), suppress_health_check=list(HealthCheck))
@given(st.sampled_from([k for k in KEYS if k.startswith(("arm.", "mount."))]), VALUES)
def test_any_arm_is_refused_or_has_a_finite_stiffness(place, key, value):
    refused_or_sound("stiffness", write(place, key, value), POSTURE, "--gravity")


@pytest.mark.parametrize("key", ["imperfections.servo_frequency_hz", "tool.shank_diameter_mm", "arm.link_mass_kg"])
def test_what_is_almost_0_is_refused_where_no_numbers_result(place, key):
    value = [1e-99] * 6 if key.startswith("arm") else 1e-99
    sentence = refused("simulate", write(place, key, value))
    assert key in sentence and ("at least" in sentence or "0, or " in sentence), sentence


def test_numbers_at_the_edge_of_what_is_allowed_still_end_within_seconds(place):
    """The bounds of every number with bounds, and almost 0, one at a time; the usual suite takes every second key.

    Sections that no pass asks are only read.
    """
    assert refused_or_sound("simulate", write(place, "arm.name", "arm")).code == 0  # the cell itself is sound
    unasked = ("uncertainty.", "limits.", "program.", "compensation.", "publish.")
    kinds, tried = {"number": float, "whole number": int}, 0
    for row in keys_of()[:: 1 if LONG else 2]:
        if row["key"] == "uncertainty.least_backlash":  # its bound is another key
            continue
        above = None if row["above"] is None else row["above"] + 1e-9
        almost = 1e-99 if row["low"] == 0.0 and row["type"] == "number" else None
        for bound in (row["low"], row["high"], above, almost) if row["type"] in kinds else ():
            if bound is not None:
                cell = write(place, row["key"], kinds[row["type"]](bound))
                if row["key"].startswith(unasked):
                    read_cell(cell)
                else:
                    refused_or_sound("simulate", cell)
                tried += 1
    assert tried > 40
