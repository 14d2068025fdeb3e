"""Make the sources of the site in a folder: the pages, a gallery of the examples, the report of the demo.

usage: python .ci/site.py FOLDER
       python .ci/site.py --picture    writes the pictures of the pages, slot.svg and surfaces.svg
"""

from __future__ import annotations

import contextlib
import io
import re
import runpy
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import plotly.io

TOP = Path(__file__).resolve().parents[1]
GUIDE = "kr270_milling/guide"
GROUPS = {
    "First steps": "tutorial surfaces several_tools decision glossary",
    "Your cell": "real_cell identification ../../config/README tool_paths",
    "Studies and Python": "maps from_python examples/README report ../../demo ../../api/kr270_milling.api",
    "ROS and controller": "nodes recordings rsi",
    "Trust": "numbers ../../CHANGELOG",
    "Contributors": "../../CONTRIBUTING contributing/design contributing/extending contributing/cam_language "
    "contributing/methods contributing/models contributing/measured contributing/call_for_data contributing/notes "
    "contributing/recompute contributing/messages contributing/benches contributing/faults contributing/book "
    "contributing/keys contributing/json contributing/conda ../../test/decide/judged/README ../../api/kr270_milling",
}
TITLES = {"api/kr270_milling.api": "Python API", "api/kr270_milling": "All modules"}


def pictures(figures: dict[Path, object]) -> None:
    """Write figures as SVG; leave them out where no browser draws them."""
    try:
        plotly.io.write_images(list(figures.values()), list(figures), width=800, height=450)
    except (ValueError, RuntimeError) as error:  # no kaleido, no Chromium
        print(f"no pictures: {str(error).strip().splitlines()[0]}", file=sys.stderr)


def figure_of(result):
    """Return the figure of a result of the package, or of the first and the last column of a table; else None."""
    from kr270_milling.show.report.study_page import points

    if hasattr(result, "columns"):
        across, up = result.columns[0], result.columns[-1]
        return points("", across, up, {up: (result[across], result[up])})
    return result.plot() if hasattr(result, "to_frame") else None


def write_gallery(page: Path) -> None:
    """Run the examples; add the code, the output and the last figure of each to their page."""
    text, figures = page.read_text(encoding="utf-8").partition("\n`.ci/docs`")[0], {}
    for example in sorted(page.parent.glob("*.py")):
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            names = runpy.run_path(str(example), run_name="__main__")
        text += f"\n## {example.stem.replace('_', ' ').capitalize()}\n\n"
        text += f"```python\n{example.read_text(encoding='utf-8')}```\n\n```output\n{printed.getvalue()}```\n"
        drawn = [figure for result in names.values() if not isinstance(result, type) and (figure := figure_of(result))]
        if drawn:
            figures[example.with_suffix(".svg")] = drawn[-1]
    pictures(figures)
    for path in filter(Path.exists, figures):
        code = f"```python\n{path.with_suffix('.py').read_text(encoding='utf-8')}"
        text = text.replace(code, f"![Figure of {path.stem}]({path.name})\n\n{code}")
    page.write_text(text, encoding="utf-8")


def write_pictures(folder: Path) -> None:
    """Write the deviation of the slot of the paper and of the surfaces, as programmed and corrected."""
    from kr270_milling import compensate, read_cell
    from kr270_milling.show.report.study_page import points

    cell = read_cell("paper.yaml", "path.length_mm=40", "stock.max_mm=[40, 12, 0]")
    results = {method: compensate(cell, method) for method in ("linear", "inverse")}
    frames = {"as programmed": results["linear"].original.to_frame()}
    frames |= {f"corrected, {method}": result.written.to_frame() for method, result in results.items()}
    lines = {name: (frame["time_s"], frame["path_deviation_um"]) for name, frame in frames.items()}
    title = "Slot of the paper: deviation of the tool from its path"
    slot = points(title, "time [s]", "deviation [um]", lines, tuple(lines))
    figures: dict[Path, object] = {folder / "slot.svg": slot}
    page, lines = (folder / "surfaces.md").read_text(encoding="utf-8"), {}
    programs = re.findall(r"<<'EOF'\n(.*?)^EOF$", page, re.MULTILINE | re.DOTALL)
    settings = ["stock.min_mm=[-25,-10,-8]", "stock.max_mm=[25,10,0]", "tool.diameter_mm=10", "timing.jerk_m_per_s3=27"]
    for name, program in zip(("upright", "leaning"), programs, strict=True):
        with tempfile.TemporaryDirectory() as made:
            (Path(made) / "part.nc").write_text(program, encoding="utf-8")
            result = compensate(read_cell("test_piece.yaml", *settings, f"path.file={made}/part.nc"), "inverse")
        for word, run in (("as programmed", result.original), ("corrected", result.written)):
            frame = run.to_frame()
            first = frame["time_s"] < frame["time_s"].max() / 3.0  # of three rows
            lines[f"{name}, {word}"] = frame["time_s"][first], frame["path_deviation_um"][first]
    title = "First row of a wave: deviation of a ball-end mill to the side"
    figures[folder / "surfaces.svg"] = points(title, "time [s]", "deviation [um]", lines, tuple(lines))
    pictures(figures)


def write_sources(folder: Path) -> None:
    """Copy the tracked files; add the groups of pages to the README, the gallery and the report of the demo."""
    listed = subprocess.run(["git", "-C", TOP, "ls-files", "-co", "--exclude-standard"], capture_output=True, text=True)
    for name in listed.stdout.splitlines():
        if (TOP / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(TOP / name, folder / name)
    write_gallery(folder / GUIDE / "examples/README.md")
    demo = ["kr270_milling", "demo", "--plain", "--out", str(folder / "extra/demo")]
    subprocess.run(demo, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    for made in (folder / "extra/demo").iterdir():
        if made.name != "report.html":
            shutil.rmtree(made) if made.is_dir() else made.unlink()
    start = '<meta http-equiv="refresh" content="0; url=README.html">'
    (folder / "extra/index.html").write_text(start, encoding="utf-8")
    link = '<a href="demo/report.html">The report</a> that `kr270_milling demo --plain` writes:'
    frame = '<iframe src="demo/report.html" title="Report of the demo" style="width: 100%; height: 80vh"></iframe>'
    (folder / "demo.md").write_text(f"# Report of the demo\n\n{link}\n\n{frame}\n", encoding="utf-8")
    trees = ""
    for caption, names in GROUPS.items():
        pages = [f"{GUIDE}/{name}".replace(f"{GUIDE}/../../", "") for name in names.split()]
        entries = "\n".join(f"{TITLES[page]} <{page}>" if page in TITLES else page for page in pages)
        trees += f"\n```{{toctree}}\n:caption: {caption}\n:hidden:\n\n{entries}\n```\n"
    with (folder / "README.md").open("a", encoding="utf-8") as readme:
        readme.write(trees)


if __name__ == "__main__":
    if sys.argv[1] == "--picture":
        write_pictures(TOP / GUIDE)
    else:
        write_sources(Path(sys.argv[1]))
