"""The pages are true: their commands, the output that they show, their tables and numbers."""

import pkgutil
import re
import shlex

import pytest
from pages import PAGES, ROOT, blocks, differences, directory_of, key_table, run_page, updated

from kr270_milling.api import compensate
from kr270_milling.base.parameter_file import find_file
from kr270_milling.base.version import __version__
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.physics.compensation.methods import methods
from kr270_milling.recordings.messages.topics import topic_table
from kr270_milling.show.commands.options import COMMANDS, make_parser

PARSER = make_parser()
TEXT = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
#: pages whose commands another test runs in the same way
RUN_ELSEWHERE = {"kr270_milling/guide/identification.md": "test_identification_commands.py"}


def shell_lines() -> list[str]:
    return [line for text in re.findall(r"```sh[^\n]*\n(.*?)```", TEXT, re.DOTALL) for line in text.splitlines()]


def commands() -> list[str]:
    """Every call of ``kr270_milling``, in blocks and in sentences, without the program's name."""
    sentences = re.findall(r"`kr270_milling\s+([^`]+)`", re.sub(r"```.*?```", "", TEXT, flags=re.DOTALL))
    lines = [
        m[1].partition(" > ")[0] for line in shell_lines() if (m := re.search(r"(?:^|bin/)kr270_milling (.+)", line))
    ]
    return [" ".join(text.split()) for text in (*lines, *sentences)]


def rows(header: str) -> list[list[str]]:
    """The cells of a Markdown table whose first line begins so."""
    lines = TEXT[TEXT.index(f"\n| {header}") + 1 :].splitlines()[2:]
    end = next(i for i, line in enumerate(lines) if not line.startswith("|"))
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines[:end]]


def name_of(page) -> str:
    return str(page.relative_to(ROOT))


# --- commands ---
@pytest.mark.parametrize("words", commands())
def test_every_command_is_one_that_the_program_takes(words):
    words = shlex.split(words, comments=True)
    if len(words) == 1:  # its name in a sentence
        words.append("--help")
        with pytest.raises(SystemExit, match="0"):
            PARSER.parse_args(words)
        return
    assert PARSER.parse_args(words).command == words[0]


def test_commands_cells_topics_and_methods_of_the_pages_are_those_of_the_package():
    assert {name for group in COMMANDS.values() for name in group} - {words.split()[0] for words in commands()} == set()
    named = {*re.findall(r"config/[\w.]+ml\b", TEXT), "config/fastdds.xml"}
    assert {str(p.relative_to(ROOT)) for p in ROOT.glob("config/*.[yx]*ml")} == named
    assert topic_table() in (ROOT / "kr270_milling" / "guide" / "nodes.md").read_text(encoding="utf-8")
    named = [re.findall(r"`(\w+)`", names)[0] for names, _ in rows("method | what it does")]
    assert sorted(named) == sorted(name for name, method in methods().items() if method.recommended)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_link_leads_to_a_file_and_the_first_line_says_the_purpose(page):
    text = page.read_text(encoding="utf-8")
    for link in re.findall(r"\]\(([^)#:]+)\)", text):
        assert (page.parent / link).exists(), link
    assert text.startswith("# ") and text.splitlines()[2]
    assert page != PAGES[0] or text.count("\n") <= 120  # the README is short


def test_the_first_screen_of_the_readme_has_picture_commands_python_and_limits_and_no_page_shows_marks():
    lines = PAGES[0].read_text(encoding="utf-8").splitlines()[:60]
    order = ["![", "demo --out out", "pytest", "```python", "**Supported**", "**Not supported**"]
    places = [next(n for n, line in enumerate(lines) if part in line) for part in order]
    assert places == sorted(places) and "<!--" not in TEXT
    assert (ROOT / "kr270_milling/guide/slot.svg").stat().st_size < 100_000


@pytest.mark.parametrize("block", [block for page in PAGES for block in blocks(page)], ids=str)
def test_a_block_of_commands_is_run_or_states_the_reason(block):
    assert block.commands
    if block.mark:
        assert len(block.reason.split()) >= 3, "state why the tests do not run this block"
    if block.mark == "not run" and block.shown:
        assert block.page.name == "README.md" and "demo" in block.reason


RUN_HERE = [page for page in PAGES if name_of(page) not in RUN_ELSEWHERE and any(not b.mark for b in blocks(page))]


@pytest.mark.parametrize("page", RUN_HERE, ids=name_of)
def test_the_commands_of_a_page_run_and_print_what_the_page_shows(page, tmp_path, monkeypatch):
    monkeypatch.chdir(directory_of(page, tmp_path))
    for block, printed in run_page(page):
        for shown in block.shown:
            assert differences(shown, printed) == [], f"{block}\n{printed}"


def test_a_shown_line_that_is_not_printed_is_named_and_brought_up_to_date():
    printed = "error 12.5 um at 3 places\n│ none │ 10.3 │\nas programmed: 7 um; and more\n"
    assert differences("error 12.4 um at 3 places\n...\nas programmed: 7 um; ...\n", printed) == []
    late = "error 12.5 um at 3 places"
    assert differences(f"│ none │ 10.3 │\n{late}\n", printed) == [late]  # the order counts
    old = "error 0.0125 mm at 3 places\n...\nas programmed: 9 um; ...\nnothing like it\n"
    assert differences(old, printed) == [line for line in old.splitlines() if line != "..."]
    new = "error 12.5 um at 3 places\n...\nas programmed: 7 um; ...\nnothing like it\n"
    assert updated(old, printed) == (new, ["nothing like it"])


def test_the_key_reference_states_every_key():
    page = (ROOT / "kr270_milling/guide/contributing/keys.md").read_text(encoding="utf-8")
    assert page.endswith("\n\n" + key_table())


FROM_PYTHON = ROOT / "kr270_milling/guide/from_python.md"


@pytest.mark.parametrize("page", [PAGES[0], FROM_PYTHON], ids=name_of)
def test_the_python_example_runs(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    exec(example, {})
    assert capsys.readouterr().out and (tmp_path / "linear.csv").is_file()


def test_every_equation_of_the_paper_has_a_function_that_exists():
    table = re.findall(r"^\| (\(.*?) \| .* \| `([\w.]+)` \|$", FROM_PYTHON.read_text(encoding="utf-8"), re.MULTILINE)
    covered = set()
    for numbers, function in table:
        for first, last in re.findall(r"\((\d+)\)(?: to \((\d+)\))?", numbers):
            covered |= set(range(int(first), int(last or first) + 1))
        pkgutil.resolve_name(f"kr270_milling.{function}")
    assert covered == set(range(1, 33))


def test_the_page_of_the_nodes_has_every_parameter_that_a_node_declares():
    live = ROOT / "kr270_milling/live"
    code = "".join(p.read_text() for p in (*live.glob("nodes/*.py"), live / "ros/node.py"))
    declared = set(re.findall(r"(?:self\.declared|self\._texts)\(\"(\w+)\"", code))
    assert declared <= {name for names, *_ in rows("parameter | node") for name in re.findall(r"`(\w+)`", names)}


def test_the_console_scripts_and_the_oldest_python_are_those_of_the_setup():
    assert 'python_requires=">=3.10"' in (ROOT / "setup.py").read_text() and "Python 3.10 to 3.13" in TEXT
    entries = re.findall(r'^(\w+) = "kr270_milling.live.nodes', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    nodes = TEXT[TEXT.index("# The nodes") :]
    lines = re.search(r"```sh[^\n]*\n(.*?)```", nodes, re.DOTALL)[1].splitlines()
    assert sorted(shlex.split(line)[0] for line in lines) == sorted(entries)


def test_the_conda_recipe_has_the_version_and_the_requirements_of_the_package():
    page = (ROOT / "kr270_milling/guide/contributing/conda.md").read_text(encoding="utf-8")
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    needed = re.findall(r'"(.+?)"', re.search(r"^dependencies = \[(.*?)^\]", project, re.DOTALL | re.MULTILINE)[1])
    run = re.search(r"  run:\n    - python >=3.10\n(.*?)  run_", page, re.DOTALL)[1]
    assert re.findall(r"- (.+)", run.replace(" ", "").replace("-", "- ")) == [name.lower() for name in needed]
    assert f'version: "{__version__}"' in page


def test_the_nodes_have_the_parameters_that_are_set_by_hand(world, short_cell, tmp_path):
    from kr270_milling.live.nodes.compliant_robot import CompliantRobot
    from kr270_milling.live.nodes.cutting_process import CuttingProcess
    from kr270_milling.live.nodes.recorder import Recorder

    nodes = {
        "compliant_robot": world.add(CompliantRobot, cell=short_cell, directory=tmp_path),
        "cutting_process": world.add(CuttingProcess, cell=short_cell, directory=tmp_path),
        "recorder": world.add(Recorder, "-p", f"directory:={tmp_path / 'r'}"),
    }  # milling_cell hands its parameters to the nodes in it
    given = [(line.split()[0], key) for line in shell_lines() for key in re.findall(r"-p (\w+):=", line)]
    exist = {(node, key): nodes[node].has_parameter(key) for node, key in given if node in nodes}
    assert len(exist) > 3 and all(exist.values()), exist


# --- tables ---
def test_the_demo_prints_what_is_shown(demo):
    """The graph of nodes, which the command of the README starts, gives the same bits."""
    (block,) = (block for block in blocks(PAGES[0]) if "demo --out out" in block.commands[0])
    assert differences(block.shown[0], demo.text.replace(demo.directory, "out")) == []


# --- numbers ---
GRID, MICRO_STEP = "stock.grid_step_um", "exchange.micro_step_deg"


@pytest.mark.parametrize(
    ("row", "place", "key", "value"), [(0, 0, GRID, 10), (2, 1, GRID, 20), (2, 2, GRID, 40), (3, 2, MICRO_STEP, 2)]
)
def test_the_convergence_table_is_what_comes_out(row, place, key, value):
    _, *cells = rows("the paper's pass")[row]
    shown = [float(re.findall(r"\d+\.?\d*", cell)[place]) for cell in cells]
    scores = simulate(read_cell(find_file("paper.yaml"), [f"{key}={value}"])).scores
    assert shown == pytest.approx([1e6 * scores.static_deviation, 1e6 * scores.max_deviation], abs=0.00051)


def test_little_damping_leaves_what_is_said():
    sentence = r"\((0\.\d+) here\) the same pass peaks at ([\d.]+) µm, and compensation leaves\s+(.*?)\.\n"
    damping, most, rest = re.search(sentence, TEXT).groups()
    cell = read_cell(find_file("paper.yaml"), [f"dynamics.damping_ratio={damping}"])
    assert simulate(cell).scores.max_deviation * 1e6 == pytest.approx(float(most), abs=0.051)
    left = re.findall(r"([\d.]+) µm \(`(\w+)`\)", rest)
    assert [method for _, method in left] == ["linear", "spline", "learned"]
    for value, method in left:
        assert compensate(cell, method).compensated.max_deviation_um == pytest.approx(float(value), abs=0.051)


def test_the_fault_table_is_that_of_the_faults():
    pytest.importorskip("rclpy")
    from faults.faults import FAULTS
    from faults.trials import COLUMNS

    table = rows("fault |")
    assert [row[0] for row in table] == [fault.name for fault in FAULTS]
    for row in (dict(zip(COLUMNS, row, strict=True)) for row in table):
        assert int(row["repeats"]) >= 10 and row["orphans"] == "0" and "FAILED" not in " ".join(row.values())
        assert row["detected within max [s]"] == "-" or float(row["detected within max [s]"]) < 3.0


# --- citation keys ---
def test_every_citation_key_has_one_entry_on_the_page_of_the_numbers_and_every_entry_is_cited():
    numbers = ROOT / "kr270_milling/guide/numbers.md"
    suffixes = (".py", ".md", ".yaml", ".csv", ".html", ".txt")
    paths = [path for folder in ("kr270_milling", "config", "test") for path in (ROOT / folder).rglob("*")]
    sources = [path for path in (ROOT / "README.md", *paths) if path.suffix in suffixes and path != numbers]
    before, _, references = numbers.read_text(encoding="utf-8").partition("## References")
    key = re.compile(r"\[([A-Z][A-Za-z]+(?:19|20)\d\d[a-z]?|REP\d+|MCAP)(?:, [^\]]+)?\]")
    entries = key.findall("\n".join(re.findall(r"^- \[.*", references, re.MULTILINE)))
    assert len(entries) == len(set(entries))
    texts = [before, *(path.read_text(encoding="utf-8") for path in sources)]
    assert set(entries) == {cited for text in texts for cited in key.findall(text)}
