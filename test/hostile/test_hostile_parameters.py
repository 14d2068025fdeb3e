"""Each key of a cell with hostile values: refused in one sentence, or an answer of finite numbers."""

from __future__ import annotations

import copy
import json
import math
import time

import pytest
import yaml
from budget import budget
from hostile import POSTURE, SHORT, ask, refused, refused_or_sound
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from kr270_milling.base.errors import MillingError
from kr270_milling.base.record import Record, build, find_file, flatten, specs
from kr270_milling.cell.cell import Cell, read_cell
from kr270_milling.exchange.replay.attached import attached_cell
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.writer import BagWriter

FLAT = flatten(read_cell(find_file("paper.yaml"), SHORT))
KEYS = sorted(FLAT)
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
    tree: dict = {}
    for name, known in {**FLAT, key: value}.items():
        if known == [] and name != key:
            continue
        group = tree
        *parents, last = name.split(".")
        for parent in parents:
            group = group.setdefault(parent, {})
        group[last] = copy.deepcopy(known)
    return {"/**": {"ros__parameters": tree}}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("cell") / "cell.yaml"


def write(place, key: str, value) -> str:
    place.write_text(yaml.dump(tree_with(key, value), Dumper=getattr(yaml, "CSafeDumper", yaml.SafeDumper)))
    return str(place)


def test_the_cell_that_is_changed_here_is_sound(place):
    assert refused_or_sound("simulate", write(place, "arm.name", "arm")).code == 0


def test_no_key_takes_what_is_no_value_of_its_kind():
    for key in KEYS:
        for value in WRONG:
            if key == "arm.name" and value is None:
                continue
            with pytest.raises(MillingError) as caught:
                build(Cell, tree_with(key, value)["/**"]["ros__parameters"], "cell.yaml")
            text = str(caught.value)
            assert key.rpartition(".")[2] in text and text.isprintable() and len(text) < 600, text


@pytest.mark.parametrize(("command", "count"), [("simulate", 200), ("check", 60), ("compensate", 40)])
def test_any_value_is_refused_or_gives_numbers_that_can_be(command, count, place, tmp_path):
    more = ["--no-verdict", "--out", str(tmp_path / "out")] if command == "compensate" else []

    @settings(max_examples=budget(count), deadline=None, suppress_health_check=list(HealthCheck), database=None)
    @given(st.sampled_from(KEYS), VALUES)
    def attempt(key, value):
        refused_or_sound(command, write(place, key, value), *more)

    attempt()


@settings(max_examples=budget(80), deadline=None, suppress_health_check=list(HealthCheck))
@given(st.sampled_from([k for k in KEYS if k.startswith(("arm.", "mount."))]), VALUES)
def test_any_arm_is_refused_or_has_a_finite_stiffness(place, key, value):
    refused_or_sound("stiffness", write(place, key, value), POSTURE, "--gravity")


@settings(max_examples=budget(60), deadline=None, suppress_health_check=list(HealthCheck))
@given(st.sampled_from(KEYS), st.text(max_size=30))
def test_any_override_is_refused_or_taken(key, text):
    answer = ask(
        "simulate", "paper.yaml", *[w for s in SHORT for w in ("--set", s)], "--set", f"{key}={text}", "--json"
    )
    assert answer.code == 0 or set(json.loads(answer.out)) == {"error", "exit_code"}


@settings(max_examples=budget(200), deadline=None, suppress_health_check=list(HealthCheck))
@given(st.one_of(st.text(), st.binary().map(lambda b: b.decode("latin-1"))), st.booleans())
def test_any_text_is_refused_as_a_cell(place, text, framed):
    place.write_text(f"/**:\n  ros__parameters: {text}\n" if framed else text, encoding="utf-8", errors="replace")
    refused("simulate", str(place))


BOMB = "\n".join(
    ["/**:", "  ros__parameters:", "    a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    + [f"    a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 40)]
)


@pytest.mark.parametrize(
    "text",
    [BOMB, BOMB.replace("a39", "path"), "a: " * 5000, "[" * 20000, "&a [*a]", "/**: &a {ros__parameters: *a}",
     "!!python/object/apply:os.system ['true']", "!!python/name:os.system", "!!binary x", "!!timestamp x", "? [a]\n: 1",
     "%YAML 9.9\n---\n", "- " * 3000, "x" * 300_000, "a: 1e400", "a: !!int 0x", "a: 2026-99-99", "<<: 3"],
)  # fmt: skip
def test_yaml_made_to_hurt_is_refused_quickly(text, place):
    place.write_text(text)
    begin = time.process_time()
    refused("simulate", str(place))
    assert time.process_time() - begin < 10.0


def test_numbers_at_the_edge_of_what_is_allowed_still_end_within_seconds(place):
    """The bounds of every number with bounds, one at a time; sections that no pass asks are only read."""
    unasked = ("uncertainty.", "limits.", "program.", "compensation.", "publish.")

    def leaves(record, prefix=""):
        for spec in specs(record):
            if issubclass(spec.kind, Record):
                yield from leaves(spec.kind, f"{prefix}{spec.key}.")
            elif spec.kind in (int, float):
                yield prefix + spec.key, spec

    tried = 0
    for key, spec in leaves(Cell):
        for bound in (spec.low, spec.high, spec.above + 1e-9):
            if math.isfinite(bound):
                cell = write(place, key, spec.kind(bound))
                read_cell(cell) if key.startswith(unasked) else refused_or_sound("simulate", cell)
                tried += 1
    assert tried > 60


def test_a_recording_whose_parameter_files_name_each_other_many_times_is_refused_at_once(tmp_path):
    """6.5 kB of attachments were read some million times by replay --recompute and report."""

    def attached(body: str) -> str:
        return "/**:\n  ros__parameters:\n" + "".join(f"    {line}\n" for line in body.splitlines())

    files = {f"{i}.yaml": attached(f"includes: {json.dumps([f'{i + 1}.yaml'] * 12)}\nk{i}: 1") for i in range(7)}
    files |= {"7.yaml": attached("k7: 1"), "cell.yaml": attached('includes: ["0.yaml"]')}
    doubled = "\n".join(f"g{i}: {{a: *g{i - 1}, b: *g{i - 1}}}" for i in range(1, 40))
    for number, attachments in enumerate([files, {"cell.yaml": attached("g0: &g0 {a: 1}\n" + doubled)}]):
        with BagWriter(tmp_path / str(number), attachments=attachments):
            pass
        begin = time.process_time()
        with Recording(tmp_path / str(number)) as recording, pytest.raises(MillingError, match="64 names|alias"):
            attached_cell(recording)
        assert time.process_time() - begin < 5
