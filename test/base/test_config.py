"""Parameter records and the one strict reader of parameter files."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from budget import budget
from hypothesis import given, settings
from hypothesis import strategies as st

from kr270_milling.base.errors import MillingError, ParameterError
from kr270_milling.base.record import (
    ConfigError,
    Record,
    build,
    flatten,
    merge,
    parameter,
    read_tree,
    specs,
)
from kr270_milling.cell.cell import Cell
from kr270_milling.physics.cutting import Tool
from kr270_milling.physics.robot import Arm

CONFIG = Path(__file__).resolve().parents[2] / "config"


@dataclass(frozen=True, eq=False)
class Inner(Record):
    length: float = parameter(unit="mm", above=0.0, high=50.0, text="a length")


@dataclass(frozen=True, eq=False)
class Sample(Record):
    """Every kind of parameter."""

    speed: float = parameter(unit="rpm", low=10.0, high=600.0, text="a speed")
    teeth: int = parameter(low=1, high=9, text="a count")
    on: bool = parameter(text="a switch")
    mode: str = parameter(text="a choice", choices=("plain", "fancy"))
    angles: np.ndarray = parameter(unit="deg", low=-90.0, high=90.0, size=2, text="two angles")
    topics: tuple = parameter((), text="names")
    inner: Inner = Inner(0.010)


GOOD = {"speed_rpm": 60.0, "teeth": 3, "on": True, "mode": "plain", "angles_deg": [30.0, -90.0], "topics": ["a", "b"]}


def refused(change: dict, key: str, drop: str = "") -> ConfigError:
    """The error about GOOD with a change; it names file, key and stands on one line."""
    tree = merge(GOOD, change)
    tree.pop(drop, None)
    with pytest.raises(ConfigError) as caught:
        build(Sample, tree, "some.yaml")
    text = str(caught.value)
    assert text.startswith(f"some.yaml: {key}: ") and text.isprintable() and caught.value.key == key
    return caught.value


def test_values_come_in_si_and_arrays_cannot_be_written():
    sample = build(Sample, GOOD)
    assert sample.speed == pytest.approx(2 * math.pi, rel=1e-15)
    np.testing.assert_allclose(sample.angles, [math.pi / 6, -math.pi / 2], rtol=1e-15)
    assert sample.teeth == 3 and sample.on is True and sample.topics == ("a", "b") and sample.inner.length == 0.010
    with pytest.raises(ValueError):
        sample.angles[0] = 0.0


def test_a_record_keeps_its_own_copy_of_an_array():
    mine = np.array([0.1, 0.2])
    sample = Sample(1.5, 1, True, "plain", mine)
    mine[0] = 9.9
    assert sample.angles[0] == 0.1


@pytest.mark.parametrize(
    ("typed", "near"), [("spede_rpm", "speed_rpm"), ("teet", "teeth"), ("angle_deg", "angles_deg")]
)
def test_an_unknown_key_is_refused_with_the_nearest_known_one(typed, near):
    assert f"did you mean {near}?" in str(refused({typed: 1.0}, typed))


def test_a_key_like_no_other_is_refused_with_all_the_known_ones():
    assert "known here: speed_rpm, teeth, on, mode" in str(refused({"zzzz": 1.0}, "zzzz"))


def test_an_unknown_key_of_a_group_is_named_with_its_group():
    assert "did you mean length_mm?" in str(refused({"inner": {"lenght_mm": 1.0}}, "inner.lenght_mm"))


def test_a_missing_key_is_refused_with_its_range_and_meaning():
    error = refused({}, "speed_rpm", drop="speed_rpm")
    assert "is missing" in str(error) and "at least 10 and at most 600" in str(error) and "(a speed)" in str(error)


def test_a_missing_group_without_default_names_its_first_key():
    with pytest.raises(ConfigError, match=r"x.yaml: arm.name: is missing"):
        build(Cell, {"start_joints_deg": [0.0] * 6}, "x.yaml")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("speed_rpm", True), ("speed_rpm", "fast"), ("speed_rpm", [60.0]), ("speed_rpm", {"a": 1}),
        ("teeth", 3.0), ("teeth", True), ("teeth", "3"), ("teeth", 10**30), ("teeth", -(10**30)),
        ("on", 1), ("on", "true"), ("mode", 1), ("mode", "Plain"), ("mode", ["plain"]),
        ("angles_deg", 30.0), ("angles_deg", [30.0]), ("angles_deg", [1.0, 2.0, 3.0]),
        ("angles_deg", [[1.0, 2.0]]), ("angles_deg", ["x", 1.0]), ("topics", "a"), ("topics", ["a", 1]),
        ("inner", 1.0), ("inner", [1.0]),
    ],
)  # fmt: skip
def test_a_value_of_the_wrong_type_is_refused_and_shown(key, value):
    error = refused({key: value}, key)
    assert error.value == value and "is not usable, it must be" in str(error)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "nan", "inf", "-Infinity", 9.99, 600.1, 1e308])
def test_a_number_out_of_range_or_not_finite_is_refused_with_the_range(value):
    assert "at least 10 and at most 600" in str(refused({"speed_rpm": value}, "speed_rpm"))


@pytest.mark.parametrize("value", [[math.nan, 0.0], [0.0, math.inf], [0.0, 90.001], [1e300, 0.0]])
def test_one_bad_number_spoils_a_list(value):
    assert "list of 2 finite numbers" in str(refused({"angles_deg": value}, "angles_deg"))


def test_an_exclusive_bound_is_refused_and_an_inclusive_one_taken():
    assert "above 0" in str(refused({"inner": {"length_mm": 0.0}}, "inner.length_mm"))
    assert build(Sample, merge(GOOD, {"inner": {"length_mm": 50.0}})).inner.length == 0.050


@pytest.mark.parametrize("key", ["speed_rpm", "teeth", "on", "mode", "angles_deg", "topics", "inner"])
def test_a_key_without_a_value_differs_from_a_missing_one(key):
    assert "has no value, it must be" in str(refused({key: None}, key))


def test_the_bounds_hold_in_the_unit_of_the_file_to_the_last_digit():
    """10 rpm to SI and back may come out an ulp low; it is still allowed."""
    for value in (10.0, 600.0):
        assert build(Sample, merge(GOOD, {"speed_rpm": value})).speed > 0


@pytest.mark.parametrize("value", [1.5, True, math.nan, 10, 0, 2**70])
def test_code_too_cannot_give_a_count_that_is_none(value):
    with pytest.raises(ParameterError, match="a whole number at least 1 and at most 9"):
        Sample(1.5, value, True, "plain", [0.0, 0.0])


def test_a_changed_copy_is_checked_too():
    sample = build(Sample, GOOD)
    assert sample.replace(teeth=4).teeth == 4 and sample.teeth == 3
    with pytest.raises(ParameterError, match="teeth is 0"):
        sample.replace(teeth=0)


def shipped_records():
    for path in sorted(CONFIG.glob("*.yaml")):
        tree = read_tree(path)
        record = Cell if "workpiece" in tree else Arm
        yield pytest.param(record, tree if record is Cell else tree["arm"], id=path.name)


def unflatten(flat: dict) -> dict:
    tree: dict = {}
    for key, value in flat.items():
        *groups, last = key.split(".")
        group = tree
        for g in groups:
            group = group.setdefault(g, {})
        group[last] = value
    return tree


@pytest.mark.parametrize(("record", "tree"), shipped_records())
def test_flattening_and_building_again_gives_every_bit(record, tree):
    first = build(record, tree)
    again = build(record, unflatten(flatten(first)))
    assert flatten(again) == flatten(first)
    assert si_values(again) == si_values(first)


def si_values(record) -> dict:
    """Every number of a record as its bytes."""
    found = {}
    for spec in specs(type(record)):
        value = getattr(record, spec.name)
        if issubclass(spec.kind, Record):
            found.update({f"{spec.name}.{k}": v for k, v in si_values(value).items()})
        else:
            found[spec.name] = value.tobytes() if isinstance(value, np.ndarray) else value
    return found


@pytest.mark.parametrize(("record", "tree"), shipped_records())
def test_a_flat_record_says_what_the_file_says_to_the_last_digit(record, tree):
    flat = flatten(build(record, tree))

    def leaves(group, prefix=""):
        for key, value in group.items():
            yield from leaves(value, f"{prefix}{key}.") if isinstance(value, dict) else [(prefix + key, value)]

    for key, value in leaves(tree):
        number = isinstance(value, str) and not isinstance(flat[key], str)  # 1e-5 is a text to YAML 1.1
        assert flat[key] == (float(value) if number else value), key


@settings(max_examples=budget(200), deadline=None)
@given(st.floats(10.0, 600.0), st.floats(-90.0, 90.0))
def test_the_numbers_of_a_file_come_back_and_their_bounds_hold_to_the_last_digit(speed, angle):
    sample = build(Sample, merge(GOOD, {"speed_rpm": speed, "angles_deg": [angle, 0.0]}))
    assert flatten(sample)["speed_rpm"] == speed and flatten(sample)["angles_deg"] == [angle, 0.0]
    changed = sample.replace(teeth=4)
    assert flatten(changed)["speed_rpm"] == speed
    assert flatten(sample.replace(speed=2.0))["speed_rpm"] == 2.0 / (2 * math.pi / 60)


@pytest.mark.parametrize("value", [np.nextafter(10.0, 0.0), np.nextafter(600.0, 1e3)])
def test_a_number_next_to_a_bound_is_refused(value):
    with pytest.raises(ConfigError, match="at least 10 and at most 600"):
        build(Sample, merge(GOOD, {"speed_rpm": float(value)}))


def all_specs(record, prefix=""):
    for spec in specs(record):
        inside = isinstance(spec.kind, type) and issubclass(spec.kind, Record)
        yield from all_specs(spec.kind, f"{prefix}{spec.key}.") if inside else [(prefix + spec.key, spec)]


def test_every_parameter_says_what_it_is_and_has_a_unit_that_the_key_ends_in():
    for key, spec in all_specs(Cell):
        assert spec.text, key
        assert key.endswith(spec.unit), key


SOURCE = re.compile(r"\[paper|\[derived\]|\[source:|assumed|identified:|\((?:\d+)\)|paper's|\bFig\. ")


@pytest.mark.parametrize("path", sorted(CONFIG.glob("*.yaml")), ids=lambda p: p.name)
def test_every_number_of_a_shipped_file_has_its_source_beside_it_or_over_its_group(path):
    over, bare, in_comment = "", [], False
    for line in path.read_text().splitlines():
        code, _, comment = line.partition("#")
        if not code.strip():  # a comment holds for the lines below it, up to the next comment or group
            over, in_comment = (over + comment if in_comment else comment), True
            continue
        in_comment = False
        if code.rstrip().endswith(":"):
            over = comment
            continue
        if re.search(r":.*\d", code) and not SOURCE.search(comment) and not SOURCE.search(over):
            bare.append(line)
    assert not [b for b in bare if "name:" not in b and "includes:" not in b]


SCALARS = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=20), st.dates(), st.binary(max_size=8)
)
VALUES = st.recursive(
    SCALARS, lambda v: st.lists(v, max_size=4) | st.dictionaries(st.text(max_size=8), v, max_size=4), max_leaves=10
)
KEYS = [key for key, _ in all_specs(Cell)]
SHIPPED = read_tree(CONFIG / "paper.yaml")


def cell_or_one_sentence(make):
    try:
        assert isinstance(make(), Cell)
    except MillingError as error:
        assert str(error).isprintable() and len(str(error)) < 3000


@settings(max_examples=budget(150), deadline=None)
@given(st.lists(st.tuples(st.sampled_from(KEYS), VALUES), min_size=1, max_size=3))
def test_any_value_for_any_key_gives_a_cell_or_one_sentence(changes):
    tree = SHIPPED
    for key, value in changes:
        for part in reversed(key.split(".")):
            value = {part: value}
        tree = merge(tree, value)
    cell_or_one_sentence(lambda: build(Cell, tree, "some.yaml"))


def test_a_tool_with_conditions_between_values_names_the_key():
    tree = {"diameter_mm": 20.0, "teeth": 2, "spindle_speed_rpm": 8000.0, "pitch_deg": [100.0, 100.0]}
    with pytest.raises(ConfigError, match=r"x.yaml: tool.pitch_deg: .* angles that sum up to 360"):
        build(Tool, tree, "x.yaml", "tool.")
