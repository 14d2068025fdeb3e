"""What the package must never do, read from its own source, and what a report does with texts from elsewhere."""

from __future__ import annotations

import ast
import html.parser
import re
from pathlib import Path

import pytest
from hostile import ask, settings
from small_part import SET

PACKAGE = Path(__file__).resolve().parents[2] / "kr270_milling"
FILES = sorted(PACKAGE.rglob("*.py"))
FORBIDDEN_CALLS = {"eval", "exec", "compile", "__import__", "os.system", "os.popen", "tempfile.mktemp",
                   "yaml.unsafe_load", "yaml.full_load", "yaml.load_all", "yaml.dump", "np.load", "numpy.load",
                   "subprocess.getoutput", "subprocess.getstatusoutput"}  # fmt: skip
FORBIDDEN_MODULES = {"pickle", "cPickle", "dill", "shelve", "marshal", "joblib", "commands", "imp"}


def offences(source: str) -> list[str]:
    """What in a source text is forbidden, with the line."""
    found = []
    for node in ast.walk(ast.parse(source)):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name.split(".")[0] for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [(node.module or "").split(".")[0]]
        found += [f"{node.lineno}: imports {name}" for name in names if name in FORBIDDEN_MODULES]
        if not isinstance(node, ast.Call):
            continue
        called, keywords = ast.unparse(node.func), {k.arg: k.value for k in node.keywords}
        safe = called == "yaml.dump" and "SafeDumper" in ast.unparse(node)
        if called in FORBIDDEN_CALLS and not safe:
            found.append(f"{node.lineno}: calls {called}")
        if called == "yaml.load" and "Loader" not in ast.unparse(node):
            found.append(f"{node.lineno}: yaml.load without a loader")
        shell = keywords.get("shell")
        if shell is not None and not (isinstance(shell, ast.Constant) and shell.value is False):
            found.append(f"{node.lineno}: starts a shell")
        if called.endswith("Environment") and "jinja2" in called and ast.unparse(keywords.get("autoescape")) != "True":
            found.append(f"{node.lineno}: a template without escapes")
    return found


def test_the_search_finds_each_kind_of_offence():
    samples = ["import pickle", "from shelve import open", "eval('1')", "import os\nos.system('a')", "yaml.load(t)",
               "subprocess.run('a', shell=True)", "subprocess.run('a', shell=x)", "tempfile.mktemp()", "np.load(f)",
               "jinja2.Environment(autoescape=False)"]  # fmt: skip
    assert all(len(offences(sample)) == 1 for sample in samples)
    fine = "yaml.load(t, Loader=Strict)\nsubprocess.run(['a'], shell=False)\njinja2.Environment(autoescape=True)"
    assert offences(fine) == []


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_no_module_runs_texts_as_programs(path):
    assert offences(path.read_text(encoding="utf-8")) == []


def test_every_loader_of_yaml_is_a_safe_one():
    import yaml

    from kr270_milling.bag.verify import LOADER
    from kr270_milling.base.parameter_file import _strict_loader

    assert issubclass(_strict_loader(), yaml.SafeLoader)
    loaders = {m for p in FILES for m in re.findall(r"Loader=([\w.]+)", p.read_text(encoding="utf-8"))}
    assert issubclass(LOADER, yaml.constructor.SafeConstructor)
    assert loaders <= {"_strict_loader", "LOADER", "yaml.SafeLoader", "yaml.CSafeLoader"}


def test_templates_mark_no_text_as_safe_but_our_own_scripts_and_styles():
    for path in PACKAGE.rglob("*.html"):
        assert "safe" not in re.findall(r"\|\s*(\w+)", path.read_text(encoding="utf-8")), path
    marked = {str(p.relative_to(PACKAGE)) for p in FILES if "Markup(" in p.read_text(encoding="utf-8")}
    assert marked == {"report/page/page.py", "watch/page.py"}


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
    # the page's own scripts are inline; a text from a file never stands in it as markup, nor in the data of a script
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
    from kr270_milling.bag.writer import BagWriter

    evil = "\x1b[2J\x1b]0;owned\x07\r\n"
    with BagWriter(tmp_path / "a", attachments={f"{evil}.yaml": evil}, metadata={evil: evil}) as writer:
        schema = (f"a/{evil}", "ros2msg", evil.encode())
        writer.add_channel(f"/{evil}", schema, "cdr", {evil: evil})
    answer = ask(command[0], str(tmp_path / "a"), *[word.format(out=tmp_path / "out") for word in command[1:]])
    assert not set("\x1b\x07\r") & set(answer.out + answer.err), answer
