"""The cell out of a recording that may be hostile."""

from __future__ import annotations

import time

import pass_recording as made
import pytest

from kr270_milling.base.errors import ConfigError, RecordingError
from kr270_milling.exchange.replay.attached import attached_cell
from kr270_milling.recordings.bag.reader import Recording

pytestmark = made.needs_messages
FORM = "/**:\n  ros__parameters:\n"


def cell_in(directory, **attached: str):
    """The cell of a recording with these files attached; "__" in a keyword is the point."""
    files = {name.replace("__", "."): text for name, text in attached.items()}
    with Recording(made.write(directory, [], attachments=files)) as recording:
        return attached_cell(recording)


@pytest.fixture
def secret(tmp_path):
    """A file of this machine that a recording must not make us read."""
    file = tmp_path / "secret.yaml"
    file.write_text(FORM + "    tool: {teeth: 2}\n")
    return file


@pytest.mark.parametrize("name", ["b__yaml", "b__txt", "b"])
def test_a_file_that_an_attached_one_includes_must_be_attached_too(tmp_path, secret, name):
    include = name.replace("__", ".")
    main = FORM + f'    includes: ["paper.yaml", "{include}"]\n'
    with pytest.raises(RecordingError, match=f"its {include} names '{secret}', which is not attached"):
        cell_in(tmp_path / "r", cell__yaml=main, **{name: FORM + f'    includes: ["{secret}"]\n'})


def test_a_tool_path_that_an_included_file_names_must_be_attached_too(tmp_path, secret):
    main = FORM + '    includes: ["paper.yaml", "b.yaml"]\n'
    with pytest.raises(RecordingError, match="its b.yaml names .* which is not attached"):
        cell_in(tmp_path / "r", cell__yaml=main, b__yaml=FORM + f'    path: {{file: "{secret}"}}\n')


@pytest.mark.parametrize("path", ["[]", "3", "null", '{file: ["a"]}'])
def test_a_group_that_cannot_be_used_does_not_open_the_way_for_an_include(tmp_path, secret, path):
    main = FORM + f'    includes: ["{secret}"]\n    path: {path}\n'
    with pytest.raises(RecordingError, match="which is not attached"):
        cell_in(tmp_path / "r", cell__yaml=main)


def test_included_files_are_read_from_the_attachments_for_every_folder(tmp_path, secret):
    main = FORM + '    includes: ["/far/away/b.yaml"]\n'
    below = FORM + '    includes: ["paper.yaml", "/other/secret.yaml"]\n'
    cell = cell_in(tmp_path / "r", cell__yaml=main, b__yaml=below, secret__yaml=secret.read_text())
    assert cell.tool.teeth == 2


def test_merged_keys_that_double_with_every_line_are_refused_at_once(tmp_path):
    lines = ["    a0: &a0 {a: b}", *(f"    a{i + 1}: &a{i + 1} {{<<: [*a{i}, *a{i}]}}" for i in range(24))]
    begin = time.process_time()
    with pytest.raises(ConfigError, match="is not valid YAML"):
        cell_in(tmp_path / "r", cell__yaml=FORM + "\n".join(lines))
    assert time.process_time() - begin < 2.0


def test_an_attachment_with_an_endless_name_is_left_alone(tmp_path):
    assert cell_in(tmp_path / "r", cell__yaml=made.cell_text(), **{"n" * 3000: ""}).path.length == pytest.approx(4e-3)
