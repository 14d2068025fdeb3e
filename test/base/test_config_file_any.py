"""Any file, any text and any assignment give a record or one sentence."""

from __future__ import annotations

import yaml
from budget import budget
from hypothesis import given, settings
from hypothesis import strategies as st
from test_config_file import GOOD, Sample, write

from kr270_milling.base.record import ConfigError, build, override, read_tree

SCALARS = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=20), st.dates(), st.binary(max_size=8)
)
VALUES = st.recursive(
    SCALARS, lambda v: st.lists(v, max_size=4) | st.dictionaries(st.text(max_size=8), v, max_size=4), max_leaves=10
)


@settings(max_examples=budget(150), deadline=None)
@given(VALUES.map(lambda v: yaml.dump({"/**": {"ros__parameters": v}}).encode()) | st.binary(max_size=200))
def test_any_file_gives_a_record_or_one_sentence(tmp_path_factory, content):
    path = write(tmp_path_factory.getbasetemp(), content)
    try:
        assert isinstance(build(Sample, read_tree(path), path), Sample)
    except ConfigError as error:
        assert str(error).isprintable() and len(str(error)) < 3000


TOKENS = st.sampled_from(
    ["/**:", " ros__parameters:", "\n", "  ", "a", ": ", "- ", "[", "]", "{", "}", ",", "&a ", "*a", "!!int ",
     "!!map ", "!!set ", "!!omap ", "!!pairs ", "!!binary ", "!!timestamp ", "!!float ", "!!bool ", "!x ", "|", ">",
     "'", '"', "#", "1", ".", "e", "-", "0x", "0b", "_", ":", "~", "? ", "%", "---\n", "...\n", "<<", "=",
     "\t", "\x00", "ü"]
)  # fmt: skip


@settings(max_examples=budget(400), deadline=None)
@given(st.lists(TOKENS, max_size=25).map("".join))
def test_any_text_out_of_pieces_of_yaml_gives_a_tree_or_one_sentence(tmp_path_factory, text):
    path = write(tmp_path_factory.getbasetemp(), text)
    try:
        assert isinstance(read_tree(path), dict)
    except ConfigError as error:
        assert str(error).isprintable()


@settings(max_examples=budget(400), deadline=None)
@given(st.sampled_from(["speed_rpm", "inner", "topics"]), st.lists(TOKENS, max_size=12).map("".join))
def test_any_assignment_gives_a_record_or_one_sentence(key, text):
    try:
        tree, _ = override(GOOD, [f"{key}={text}"])
        assert isinstance(build(Sample, tree), Sample)
    except ConfigError as error:
        assert str(error).isprintable()
