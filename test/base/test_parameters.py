"""Parameter records and parameter files: values, units, includes, assignments; any other text ends in one sentence."""

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from budget import budget
from hypothesis import given, settings
from hypothesis import strategies as st

from kr270_milling.base import parameter_file
from kr270_milling.base.errors import ConfigError, ParameterError
from kr270_milling.base.parameter_file import find_file, merge, override, read_tree
from kr270_milling.base.record import Record, build, flatten, parameter, specs, tree_of
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
    teeth: int = parameter(3, low=1, high=9, text="a count")
    on: bool = parameter(True, text="a switch")
    mode: str = parameter("plain", text="a choice", choices=("plain", "fancy"))
    angles: np.ndarray = parameter([0.0, 0.0], unit="deg", low=-90.0, high=90.0, size=2, text="two angles")
    topics: tuple = parameter((), text="names")
    inner: Inner = Inner(0.010)


GOOD = {"speed_rpm": 60.0, "teeth": 3, "on": True, "mode": "plain", "angles_deg": [30.0, -90.0], "topics": ["a", "b"]}


def refused(change: dict, key: str, drop: str = "") -> ConfigError:
    """The error about GOOD with a change; its one line has file and key."""
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
    mine = np.array([0.1, 0.2])
    sample = Sample(1.5, 1, True, "plain", mine)
    mine[0] = 9.9  # the record has a copy
    assert sample.angles[0] == 0.1


@pytest.mark.parametrize(("change", "key", "text"), [
    ({"spede_rpm": 1.0}, "spede_rpm", "did you mean speed_rpm?"),
    ({"inner": {"lenght_mm": 1.0}}, "inner.lenght_mm", "did you mean length_mm?"),
    ({"zzzz": 1.0}, "zzzz", "known here: speed_rpm, teeth, on, mode"),
])  # fmt: skip
def test_an_unknown_key_is_refused_with_the_nearest_known_one_or_with_all(change, key, text):
    assert text in str(refused(change, key))


def test_a_missing_key_is_refused_with_its_range_and_meaning_and_a_condition_between_values_with_its_key():
    error = refused({}, "speed_rpm", drop="speed_rpm")
    assert "is missing" in str(error) and "at least 10 and at most 600" in str(error) and "(a speed)" in str(error)
    with pytest.raises(ConfigError, match=r"x.yaml: arm.name: is missing"):  # the first key of a missing group
        build(Cell, {"start_joints_deg": [0.0] * 6}, "x.yaml")
    tree = {"diameter_mm": 20.0, "teeth": 2, "spindle_speed_rpm": 8000.0, "pitch_deg": [100.0, 100.0]}
    with pytest.raises(ConfigError, match=r"x.yaml: tool.pitch_deg: .* angles that sum up to 360"):
        build(Tool, tree, "x.yaml", "tool.")


SPEED, ANGLES = "at least 10 and at most 600", "list of 2 finite numbers"
UNUSABLE = "is not usable, it must be"


@pytest.mark.parametrize(("key", "values", "text"), [
    ("speed_rpm", [True, "fast", [60.0], {"a": 1}], UNUSABLE),
    ("speed_rpm", [math.nan, math.inf, -math.inf, "nan", "inf", "-Infinity", 1e308], SPEED),
    ("speed_rpm", [float(np.nextafter(10.0, 0.0)), float(np.nextafter(600.0, 1e3))], SPEED),
    ("teeth", [3.0, True, "3", 10**30, -(10**30)], UNUSABLE), ("on", [1, "true"], UNUSABLE),
    ("mode", [1, "Plain", ["plain"]], UNUSABLE), ("topics", ["a", ["a", 1]], UNUSABLE),
    ("angles_deg", [30.0, [30.0], [1.0, 2.0, 3.0], [[1.0, 2.0]], ["x", 1.0]], UNUSABLE),
    ("angles_deg", [[math.nan, 0.0], [0.0, math.inf], [0.0, 90.001], [1e300, 0.0]], ANGLES),
    ("inner", [1.0, [1.0]], UNUSABLE), ("inner.length_mm", [0.0], "above 0"),
    *[(key, [None], "has no value, it must be") for key in (*GOOD, "inner")],
])  # fmt: skip
def test_a_value_of_the_wrong_type_or_out_of_range_is_refused_and_shown(key, values, text):
    group, _, last = key.rpartition(".")
    for value in values:
        error = refused({group: {last: value}} if group else {key: value}, key)
        assert text in str(error) and (text != UNUSABLE or error.value == value)


def test_code_too_cannot_give_a_count_that_is_none():
    sample = build(Sample, GOOD)
    assert sample.replace(teeth=4).teeth == 4 and sample.teeth == 3
    for value in (1.5, True, math.nan, 10, 0, 2**70):
        with pytest.raises(ParameterError, match="a whole number at least 1 and at most 9"):
            sample.replace(teeth=value)


@pytest.mark.parametrize(("name", "values", "allowed"), [
    ("speed", ["2", [2.0], None, 1j, 10**400], SPEED), ("on", [0, "no"], "true or false"),
    ("mode", [["plain"], None], "one"), ("topics", [3], "a list"), ("inner", [None, 0.01], "a record Inner"),
    ("angles", ["abc", [1.0, [2.0]], None], ANGLES),
])  # fmt: skip
def test_a_value_of_another_type_in_code_is_refused(name, values, allowed):
    for value in values:
        with pytest.raises(ParameterError, match=f"{name}.* but must be .*{allowed}"):
            build(Sample, GOOD).replace(**{name: value})


def shipped_records():
    for path in sorted(CONFIG.glob("*.yaml")):
        tree = read_tree(path)
        record = Cell if "workpiece" in tree else Arm
        yield pytest.param(record, tree if record is Cell else tree["arm"], id=path.name)


@pytest.mark.parametrize(("record", "tree"), shipped_records())
def test_a_record_has_the_numbers_of_the_file_to_the_last_digit_and_comes_back_with_every_bit(record, tree):
    first = build(record, tree)
    again, flat = build(record, tree_of(first)), flatten(first)
    assert flatten(again) == flat and si_values(again) == si_values(first)

    def leaves(group, prefix=""):
        for key, value in group.items():
            yield from leaves(value, f"{prefix}{key}.") if isinstance(value, dict) else [(prefix + key, value)]

    for key, value in leaves(tree):
        number = isinstance(value, str) and not isinstance(flat[key], str)  # 1e-5 is a text to YAML 1.1
        assert flat[key] == (float(value) if number else value), key


def si_values(record) -> list:
    """Every value of a record; of arrays the bytes."""
    values = [getattr(record, spec.name) for spec in specs(type(record))]
    return [si_values(v) if isinstance(v, Record) else v.tobytes() if isinstance(v, np.ndarray) else v for v in values]


@settings(max_examples=budget(200), deadline=None)
@given(st.floats(10.0, 600.0), st.floats(-90.0, 90.0))
def test_the_numbers_of_a_file_come_back_and_their_bounds_hold_to_the_last_digit(speed, angle):
    sample = build(Sample, merge(GOOD, {"speed_rpm": speed, "angles_deg": [angle, 0.0]}))
    assert flatten(sample)["speed_rpm"] == speed and flatten(sample)["angles_deg"] == [angle, 0.0]
    changed = sample.replace(teeth=4)
    assert flatten(changed)["speed_rpm"] == speed
    assert flatten(sample.replace(speed=2.0))["speed_rpm"] == 2.0 / (2 * math.pi / 60)


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


# --- Parameter files ---
def write(directory, text, name="cell.yaml") -> Path:
    path = directory / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def wrapped(body: str) -> str:
    """The body as the parameters of a ROS parameter file."""
    return "/**:\n  ros__parameters:\n" + "".join(f"    {line}\n" for line in body.splitlines())


def refusal_of(path, *names) -> str:
    """The sentence about a file that cannot be read."""
    with pytest.raises(ConfigError) as caught:
        read_tree(path)
    text = str(caught.value)
    assert text.startswith(str(path)) and text.isprintable() and all(n in text for n in names), text
    return text


FORM, NESTED = ["/**: ros__parameters"], ["nested too deeply"]


@pytest.mark.parametrize(("text", "names"), [
    *((text, FORM) for text in (b"", b"just words", b"arm: {a: 1}", b"/**:\n  ros__parameters:\n  extra: 1\n")),
    (b"/**:\n  ros__parameters: [1]\n", ["ros__parameters", "a group of keys"]),
    (b"/**:\n  ros__parameters:\n", ["ros__parameters", "has no value"]),
    ("größe: 1".encode("latin-1"), ["UTF-8"]), (b"a: [1, 2\nb: }", ["YAML"]), (b"a: \0", ["YAML"]),
    (b"a: 1\na: 2\n", ["'a'", "twice", "line 2"]),
    (wrapped("tool:\n  teeth: 4\n  teeth: 2").encode(), ["'teeth'", "twice", "line 5"]),
    (b"/**: !!python/object:os.system {}", ["YAML", "python/object"]), (b"<<: {a: 1}", ["YAML"]),
    *((f"/**: {value}".encode(), ["YAML"]) for value in (
        "!!map [3]", "!!timestamp never", "!!bool perhaps", "!!int ''", "!!float 1e", "2026-99-99")),
    *((f"/**: {value}".encode(), ["YAML", value]) for value in ("1:30.0", "12:30", "010", "-0_17")),
    *((f"/**: {{{key}: 2}}".encode(), ["YAML", "not a text"]) for key in ("? [a, b] ", "1", "true")),
    *((opened * 600, NESTED) for opened in (b"[", b"{a: ", b"- ")), (b"x" * 300_000, ["more than 262144 bytes"]),
    (b"/**: {ros__parameters: {includes: kr270_2.yaml}}", ["includes", "a list of file names"]),
    (b"/**: {ros__parameters: {includes: [1]}}", ["includes", "a list of file names"]),
    (b"/**: {ros__parameters: {includes: }}", ["includes", "has no value"]),
    (("g0: &g0 {a: 1}\n" + "g1: *g0\n").encode(), ["alias", "line 2"]), (b"/**: &a {b: [*a]}", ["alias"]),
])  # fmt: skip
def test_a_file_of_another_form_is_refused_in_one_sentence(tmp_path, text, names):
    refusal_of(write(tmp_path, text), *names)


def test_numbers_and_keys_of_yaml_are_those_of_ros(tmp_path):
    assert read_tree(write(tmp_path, b"\xef\xbb\xbf" + wrapped("a: 1").encode())) == {"a": 1}  # a byte order mark
    tree = read_tree(write(tmp_path, wrapped("length_mm: 1e1")))
    assert tree == {"length_mm": "1e1"} and build(Inner, tree).length == 0.010  # for YAML 1.1 alone this is a text
    for value in ("0x" + "f" * 5000, "9" * 500):
        tree = read_tree(write(tmp_path, wrapped(f"teeth: {value}")))
        assert "a whole number" in str(refused(tree, "teeth")) and len(str(refused(tree, "teeth"))) < 400
    tree = read_tree(write(tmp_path, wrapped('"a\\nb\\e[31m": 1')))
    with pytest.raises(ConfigError) as caught:
        build(Inner, tree, "some.yaml")
    assert str(caught.value).isprintable()


def test_a_file_that_is_named_many_times_is_read_once_and_too_many_names_are_refused(tmp_path, monkeypatch):
    """Twelve names a level and seven levels were 36 million files to read."""
    read, paths = parameter_file.read_yaml, []
    monkeypatch.setattr(parameter_file, "read_yaml", lambda path: paths.append(path) or read(path))

    def chain(names: int, levels: int) -> dict:
        paths.clear()
        for level in range(levels):
            lines = f"includes: [{', '.join([f'level{level + 1}.yaml'] * names)}]\nlevel{level}: 1"
            write(tmp_path, wrapped(lines), f"level{level}.yaml")
        write(tmp_path, wrapped(f"level{levels}: 1"), f"level{levels}.yaml")
        return read_tree(tmp_path / "level0.yaml")

    assert chain(2, 7) == {f"level{i}": 1 for i in range(8)} and len(paths) == 8
    assert len(chain(1, 8)) == 9
    for names, levels in ((12, 7), (1, 9), (1, 30)):
        with pytest.raises(ConfigError, match="at most 64 names of files in all, 8 deep"):
            chain(names, levels)
        assert len(paths) <= 16


def test_the_including_file_overrides_the_included_and_later_includes_earlier_ones(tmp_path):
    (tmp_path / "sub").mkdir()
    write(tmp_path / "sub", wrapped("g: {a: 1, b: 1, c: 1, d: 1}"), "one.yaml")
    write(tmp_path / "sub", wrapped("includes: [one.yaml]\ng: {b: 2, c: 2}"), "two.yaml")  # beside the file
    write(tmp_path, wrapped("g: {c: 3}\nlist: [1, 2]"), "three.yaml")
    top = write(tmp_path, wrapped("includes: [sub/two.yaml, three.yaml]\ng: {d: 4}\nlist: [5]"))
    assert read_tree(top) == {"g": {"a": 1, "b": 2, "c": 3, "d": 4}, "list": [5]}
    twice = wrapped("includes: [three.yaml, sub/two.yaml, three.yaml]")
    assert read_tree(write(tmp_path, twice))["g"] == {"a": 1, "b": 2, "c": 3, "d": 1}


def test_a_directory_a_missing_file_or_include_and_a_circle_of_includes_are_refused(tmp_path):
    refusal_of(tmp_path, "cannot be read", "directory")
    refusal_of(tmp_path / "none.yaml", "cannot be read", "No such file")
    for length in (1, 3):
        for i in range(length):
            write(tmp_path, wrapped(f"includes: [f{(i + 1) % length}.yaml]"), f"f{i}.yaml")
        with pytest.raises(ConfigError, match="includes.*free of circles"):
            read_tree(tmp_path / "f0.yaml")
    for name in ("none.yaml", "", "..", "sub/none.yaml", "a\\0b", "x" * 300, "wrong/kr270_2.yaml"):
        reason = "is a directory, not a file" if name in ("", "..") else "is no such file"
        with pytest.raises(ConfigError, match=reason):
            read_tree(write(tmp_path, wrapped(f'includes: ["{name}"]')))


def test_shipped_files_are_found_by_name_from_anywhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert find_file("paper.yaml").samefile(CONFIG / "paper.yaml")
    assert find_file("config/paper.yaml").samefile(CONFIG / "paper.yaml")
    with pytest.raises(ConfigError, match="is no such file"):
        find_file("confg/paper.yaml")  # a mistyped folder never ends at a shipped file
    write(tmp_path, "", "paper.yaml")
    assert find_file("paper.yaml").resolve() == tmp_path / "paper.yaml"  # the user's own file comes first


def test_an_assignment_sets_a_nested_key_of_a_copy_and_the_last_one_wins():
    before = {"g": {"a": 1, "b": 2}}
    tree, keys = override(before, ["g.a=3", "h.i.j=[1, 2]", "g.a=4", "t=x=y"])
    assert tree == {"g": {"a": 4, "b": 2}, "h": {"i": {"j": [1, 2]}}, "t": "x=y"} and before["g"]["a"] == 1
    assert keys == {"g.a", "h.i.j", "t"}
    tree, _ = override(GOOD, ["speed_rpm=60", "angles_deg=[1, 2]", "inner.length_mm=5"])  # a whole number is a float
    sample = build(Sample, tree)
    assert sample.speed == pytest.approx(2 * math.pi) and sample.inner.length == 0.005


@pytest.mark.parametrize(("text", "names"), [
    *((text, ["key=value"]) for text in ("speed_rpm", "=3", ".a=3", "a..b=3")),
    ("speed_rpm=", ["speed_rpm", "has no value"]), ("speed_rpm=[", ["speed_rpm", "YAML"]),
    *((f"speed_rpm={value}", ["speed_rpm", "at most 600"]) for value in ("fast", "1e400", 10**400)),
    ("speed_rpm=" + "[" * 600, ["speed_rpm", "nested too deeply"]), ("inner=3", ["inner", "a group of keys"]),
    ("inner={length_mm: 1.0, length_mm: 2.0}", ["inner", "twice"]), ("speed_rpm.x=1", ["speed_rpm", "finite number"]),
])  # fmt: skip
def test_a_bad_assignment_is_refused(text, names):
    with pytest.raises(ConfigError) as caught:
        tree, _ = override(GOOD, [text])
        build(Sample, tree, "some.yaml")
    assert str(caught.value).isprintable() and all(n in str(caught.value) for n in names), str(caught.value)


TOKENS = st.sampled_from(
    ["/**:", " ros__parameters:", "\n", "  ", "a", ": ", "- ", "[", "]", "{", "}", ",", "&a ", "*a", "!!int ",
     "!!map ", "!!set ", "!!omap ", "!!pairs ", "!!binary ", "!!timestamp ", "!!float ", "!!bool ", "!x ", "|", ">",
     "'", '"', "#", "1", ".", "e", "-", "0x", "0b", "_", ":", "~", "? ", "%", "---\n", "...\n", "<<", "=",
     "\t", "\x00", "ü"]
)  # fmt: skip
PIECES = st.lists(TOKENS, max_size=25).map("".join)


@settings(max_examples=budget(400))
@given(st.binary(max_size=200) | PIECES.map(str.encode), st.sampled_from(["speed_rpm", "inner"]), PIECES)
def test_any_file_and_any_assignment_gives_a_record_or_one_sentence(tmp_path_factory, content, key, text):
    def one(read) -> None:
        try:
            build(Sample, read(), path)
        except ConfigError as error:
            assert str(error).isprintable() and len(str(error)) < 3000

    path = write(tmp_path_factory.getbasetemp(), content)
    one(lambda: read_tree(path))
    one(lambda: override(GOOD, [f"{key}={text}"])[0])
