"""What reports and the terminal do with texts from elsewhere; that the package runs none of them is ruff's business."""

from __future__ import annotations

import html.parser
from pathlib import Path

import pytest
from hostile import ask, settings
from small_part import SET


class Page(html.parser.HTMLParser):
    """Tags, attributes and texts of a page."""

    def __init__(self):
        super().__init__()
        self.tags, self.attributes, self.texts = set(), set(), []

    def handle_starttag(self, tag, attributes):
        self.tags.add(tag)
        self.attributes |= {name for name, _ in attributes}

    def handle_data(self, data):
        self.texts.append(data)


EVIL = "<script>alert(1)</script><img src=x onerror=alert(2)>&lt;{{ 7*7 }}\"'"
GCODE = """G21 G90 S8000 M3
G0 X-14 Y0 Z2
G0 Z-0.5
(</title></svg><script>evil4</script>)
G1 X6 F4000
(<img src=x onerror=evil3>)
G1 X8 Y2
G0 Z2
M30
"""


def looked_at(path: Path) -> Page:
    page = Page()
    text = path.read_text(encoding="utf-8")
    page.feed(text)
    # the page's own scripts are inline; a text from a file is never markup, nor in the data of a script
    assert not [evil for evil in ("<script>alert", "<script>evil", "<img src=x", "</title></svg>") if evil in text]
    assert not page.tags & {"img", "iframe", "object", "embed", "link"}, page.tags
    assert not [name for name in page.attributes if name.startswith("on")]
    return page


def test_a_report_shows_texts_from_files_and_does_not_run_them(tmp_path):
    """Names of arm, cell file and folder; a comment of the program names a feature only if it is one word."""
    folder = tmp_path / "<script>alert(5)<" / "b onclick=x"
    folder.mkdir(parents=True)
    (folder / "path <i>.nc").write_text(GCODE)
    name = EVIL.replace("\\", "\\\\").replace('"', '\\"')
    text = (f'/**:\n  ros__parameters:\n    includes: ["paper.yaml"]\n    arm: {{name: "{name}"}}\n'
            f'    path: {{file: "path <i>.nc"}}\n')  # fmt: skip
    (folder / "cell <u>.yaml").write_text(text)
    cell = str(folder / "cell <u>.yaml")
    answer = ask("compensate", cell, *settings(*SET), "--method=linear", "--no-verdict", "--out", str(tmp_path / "out"))
    assert answer.code in (0, 1), answer
    page = looked_at(tmp_path / "out" / "report.html")
    shown = " ".join(page.texts)
    for part in ("<script>alert(1)</script>", "{{ 7*7 }}", "cell <u>.yaml", "path <i>.nc"):
        assert part in shown, part


def test_a_report_of_a_recording_shows_its_texts_and_does_not_run_them(tmp_path):
    pytest.importorskip("geometry_msgs")
    import pass_recording

    name = EVIL.replace('"', '\\"')
    cell = pass_recording.cell_text() + f'    arm: {{name: "{name}"}}\n'
    recording = pass_recording.write(tmp_path / "<b onload=x>", pass_recording.one_pass(), cell=cell)
    answer = ask("report", str(recording), "--out", str(tmp_path / "out"))
    assert answer.code == 0, answer
    shown = " ".join(looked_at(tmp_path / "out" / "report.html").texts)
    assert "<script>alert(1)</script>" in shown and "{{ 7*7 }}" in shown


@pytest.mark.parametrize("command", [["info"], ["replay", "--recompute"], ["export", "--csv", "{out}"]])
def test_texts_of_a_recording_do_not_steer_the_terminal(command, tmp_path):
    pytest.importorskip("geometry_msgs")
    from kr270_milling.recordings.bag.writer import BagWriter

    evil = "\x1b[2J\x1b]0;owned\x07\r\n"
    with BagWriter(tmp_path / "a", attachments={f"{evil}.yaml": evil}, metadata={evil: evil}) as writer:
        schema = (f"a/{evil}", "ros2msg", evil.encode())
        writer.add_channel(f"/{evil}", schema, "cdr", {evil: evil})
    answer = ask(command[0], str(tmp_path / "a"), *[word.format(out=tmp_path / "out") for word in command[1:]])
    assert not set("\x1b\x07\r") & set(answer.out + answer.err), answer
