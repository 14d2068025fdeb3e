"""Every command with input files that are none, with output places that must not change, with texts from elsewhere."""

from __future__ import annotations

import html.parser
import os
import stat
import sys
from pathlib import Path

import pass_recording
import pytest
from hostile import POSTURE, SHORT, ask, contents, refused, settings
from recording_samples import record
from small_part import SET

from kr270_milling.base.parameter_file import find_file
from kr270_milling.recordings.bag.writer import BagWriter

GARBAGE = bytes(range(256)) * 40
CONTENTS = {"empty": b"", "garbage": GARBAGE, "text": b"hello\nworld\n", "zeros": bytes(5000)}
PLACES = {"device": "/dev/null", "endless": "/dev/zero", "below a file": f"{__file__}/file",
          "long name": f"{{path}}{'n' * 5000}", "zero byte in the name": "{path}\0"}  # fmt: skip
MAKERS = {
    "missing": lambda path: None,
    "directory": Path.mkdir,
    "pipe": os.mkfifo,
    "circle": lambda path: path.symlink_to(path),
    "sparse": lambda path: (path.touch(), os.truncate(path, 1 << 26 if path.suffix == ".mcap" else 5 << 28)),
}


def made(kind: str, path: Path) -> str:
    """Make a hostile thing at a path; return its name."""
    if kind in CONTENTS:
        path.write_bytes(CONTENTS[kind])
    elif kind in MAKERS:
        MAKERS[kind](path)
    return PLACES.get(kind, "{path}").format(path=path)


COMMANDS = {
    "stiffness": ("stiffness", "{file}", POSTURE),
    "simulate": ("simulate", "{file}", "--out", "{out}"),
    "reference": ("simulate", "paper.yaml", *settings(*SHORT), "--reference", "{file}", "--out", "{out}"),
    "path": ("simulate", "paper.yaml", "--set", "path.file={file}", "--out", "{out}"),
    "compensate": ("compensate", "{file}", "--no-verdict", "--out", "{out}"),
    "check": ("check", "{file}"),
    "corrected": ("check", "paper.yaml", *settings(*SHORT), "--reference", "{file}"),
    "run": ("run", "{file}", "--out", "{out}"),
    "info": ("info", "{file}"),
    "recompute": ("replay", "{file}", "--recompute"),
    "revise": ("replay", "{file}", "--compensate", "--out", "{out}"),
    "export": ("export", "{file}", "--csv", "{out}"),
    "report": ("report", "{file}", "--out", "{out}"),
    "recover": ("recover", "{file}", "--out", "{out}"),
    "compliance": ("identify", "compliance", "{file}", "--arm", "kr270_2.yaml", "--out", "{out}"),
    "forces": ("identify", "forces", "{file}", "--cell", "test_piece.yaml", "--out", "{out}"),
    "ring-down": ("identify", "damping", "{file}", "--out", "{out}"),
    "recorded ring-down": ("identify", "damping", "{file}", "--out", "{out}"),
    "UFF": ("identify", "damping", "{file}", "--out", "{out}"),
    "compare": ("compare", "{file}", "paper.yaml", *settings(*SHORT), "--out", "{out}"),
}
ENDS = {"reference": ".csv", "corrected": ".csv", "path": ".nc", "stiffness": ".yaml", "simulate": ".yaml",
        "compensate": ".yaml", "check": ".yaml", "run": ".yaml", "compliance": ".csv", "forces": ".csv",
        "ring-down": ".csv",
        "UFF": ".uff"}  # fmt: skip


def words(name: str, file, out) -> list[str]:
    return [word.format(file=file, out=out) for word in COMMANDS[name]]


#: one command for each reader: parameter file, text, recording, recovery, measured signals
@pytest.mark.parametrize("name", ["stiffness", "path", "info", "recover", "UFF"])
@pytest.mark.parametrize("kind", [*CONTENTS, *PLACES, *MAKERS])
def test_every_reader_refuses_what_is_no_such_file_in_one_sentence(name, kind, tmp_path):
    path = made(kind, tmp_path / f"thing{ENDS.get(name, '.mcap')}")
    refused(*words(name, path, tmp_path / "out"))
    assert not list(tmp_path.glob("*out*"))


@pytest.mark.skipif(sys.platform != "linux", reason="file names are bytes")
@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_refuses_missing_files_and_garbage_of_any_name(name, tmp_path):
    strange = b"-x\xff\xfea\nb\x1b[2J<b>" + "ä".encode() + ENDS.get(name, ".mcap").encode()
    path = os.fsdecode(os.path.join(os.fsencode(tmp_path), strange))
    refused(*words(name, path, tmp_path / "out"))
    Path(path).write_bytes(GARBAGE)
    refused(*words(name, path, tmp_path / "out"))
    left = contents(tmp_path)
    assert left.pop("out", "dir") == "dir" and list(left.values()) == [GARBAGE]


def test_a_cell_with_a_name_that_is_no_text_is_run(tmp_path):
    """Sentences, tables and files contain the name."""
    folder = os.fsdecode(os.path.join(os.fsencode(tmp_path), b"\xff"))
    os.mkdir(folder)
    cell = Path(folder, os.fsdecode(b"\xfe.yaml"))
    cell.write_text(find_file("paper.yaml").read_text())
    answer = ask("simulate", str(cell), *settings(*SHORT), "--json")
    assert answer.code == 0 and "original" in answer.out, answer
    more = ["--method", "linear", "--no-verdict", "--out", f"{folder}/out"]
    answer = ask("compensate", str(cell), *settings(*SHORT), *more)
    assert answer.code in (0, 1) and answer.err == "", answer


def test_a_reference_that_is_none_for_this_path_is_refused(tmp_path):
    """Huge, backward and unfinished tables."""
    head = "time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw\n"
    rows = {
        "huge": "0,0,0,0,1,0,0,0\n1,1e30,0,0,1,0,0,0\n",
        "far": "0,0,0,0,1,0,0,0\n0.05,50,0,0,1,0,0,0\n0.06,0,0,0,1,0,0,0\n",
        "longer": "0,-0.01,0,-0.0005,1,0,0,0\n0.07,-0.006,0,-0.0005,1,0,0,0\n",
        "days": "0,0,0,0,1,0,0,0\n9e8,0.01,0,0,1,0,0,0\n",
        "backward": "0,0,0,0,1,0,0,0\n-1,0.1,0,0,1,0,0,0\n",
        "infinite": "0,0,0,0,1,0,0,0\n1,inf,0,0,1,0,0,0\n",
        "turned": "0,0,0,0,0,0,0,0\n1,0.1,0,0,1,0,0,0\n",
        "cut off": "0,0,0,0,1,0,0,0\n1,0.1,0,0,1,0",
    }
    for name, text in rows.items():
        file = tmp_path / f"{name}.csv"
        file.write_text(head + text)
        refused("simulate", "paper.yaml", *settings(*SHORT), "--reference", str(file))
        checked = ask("check", "paper.yaml", *settings(*SHORT), "--reference", str(file))
        assert checked.code == 2 or (checked.code == 1 and "must not be run" in checked.out)


SECRET = b"not to be touched"
WRITERS = {
    "simulate": ("simulate", "paper.yaml", *settings(*SHORT), "--out", "{out}"),
    "compensate": ("compensate", "paper.yaml", *settings(*SHORT), "--method=linear", "--no-verdict", "--out", "{out}"),
    "demo": ("demo", "--plain", "--out", "{out}"),
    "export": ("export", "{recording}", "--csv", "{out}"),
    "revise": ("replay", "{passed}", "--compensate", "--out", "{out}"),
    "report": ("report", "{passed}", "--out", "{out}"),
    "recover": ("recover", "{recording}", "--out", "{out}"),
}


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """One of every topic, and one of a whole pass."""
    pytest.importorskip("geometry_msgs")
    directory = tmp_path_factory.mktemp("recordings")
    record(directory / "topics", 5)
    pass_recording.write(directory / "pass", pass_recording.one_pass())
    return {"recording": str(directory / "topics"), "passed": str(directory / "pass")}


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("place", ["file", "a\0b"])
def test_a_place_that_cannot_be_written_into_is_refused_before_the_work(name, place, recordings, tmp_path):
    (tmp_path / "file").write_bytes(SECRET)
    refused(*[word.format(out=tmp_path / place, **recordings) for word in WRITERS[name]])
    assert contents(tmp_path) == {"file": SECRET}


@pytest.mark.parametrize("name", [name for name in WRITERS if name != "demo"])  # which has no option to be short
def test_files_have_the_permissions_of_the_umask_and_replace_links_but_not_their_targets(name, recordings, tmp_path):
    """Each file that a command wrote is, the next time, a link to a file elsewhere."""
    out, victim, before = tmp_path / "out", tmp_path / "victim", os.umask(0o027)
    words = [word.format(out=out, **recordings) for word in WRITERS[name]]
    try:
        if name != "recover":  # a recording is never written beside other files
            out.mkdir()
            (out / "mine.txt").write_bytes(SECRET)
        answer = ask(*words)
    finally:
        os.umask(before)
    assert answer.code in (0, 1) and answer.err == "", answer
    files = {file: data for file, data in contents(out).items() if data not in ("dir", SECRET)}
    assert files and all(files.values()) and not any(".part" in file for file in files)
    assert {stat.S_IMODE((out / file).stat().st_mode) for file in files} == {0o640}
    assert name == "recover" or (out / "mine.txt").read_bytes() == SECRET
    victim.write_bytes(SECRET)
    for file in files:
        (out / file).unlink()
        (out / file).symlink_to(victim)
    answer = ask(*words)
    assert victim.read_bytes() == SECRET and (answer.code == 2) == (name == "recover")
    assert name == "recover" or not any((out / file).is_symlink() for file in files)


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


@pytest.mark.parametrize("command", [["info"], ["replay", "--recompute"], ["export", "--csv", "{out}"]])
def test_texts_of_a_recording_do_not_steer_the_terminal(command, tmp_path):
    pytest.importorskip("geometry_msgs")
    evil = "\x1b[2J\x1b]0;owned\x07\r\n"
    with BagWriter(tmp_path / "a", attachments={f"{evil}.yaml": evil}, metadata={evil: evil}) as writer:
        schema = (f"a/{evil}", "ros2msg", evil.encode())
        writer.add_channel(f"/{evil}", schema, "cdr", {evil: evil})
    answer = ask(command[0], str(tmp_path / "a"), *[word.format(out=tmp_path / "out") for word in command[1:]])
    assert not set("\x1b\x07\r") & set(answer.out + answer.err), answer
