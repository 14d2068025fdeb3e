"""Citation keys and pointers from parameter files: each has its entry, each entry has a citation."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "kr270_milling/guide/numbers.md"
KEY = re.compile(r"\[([A-Z][A-Za-z]+(?:19|20)\d\d[a-z]?|REP\d+|MCAP)(?:, [^\]]+)?\]")


def texts():
    for folder in ("kr270_milling", "config", "test"):
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in (".py", ".md", ".yaml", ".csv", ".html", ".txt") and path != PAGE:
                yield path.read_text(encoding="utf-8")
    yield (ROOT / "README.md").read_text(encoding="utf-8")


def test_every_citation_key_has_one_entry_on_the_page_of_the_numbers_and_every_entry_is_cited():
    page = PAGE.read_text(encoding="utf-8")
    entries = [key for line in page[page.index("## References") :].splitlines() if line[:3] == "- [" for key in
               KEY.findall(line)]  # fmt: skip
    cited = {key for text in (*texts(), page[: page.index("## References")]) for key in KEY.findall(text)}
    assert len(entries) == len(set(entries))
    assert set(entries) == cited


def test_a_page_that_a_parameter_file_names_exists():
    """A pointer names a path from the root of the repository, or from the package."""
    for path in (ROOT / "config").glob("*.yaml"):
        text = path.read_text(encoding="utf-8")
        assert "README" not in text, f"{path.name} points to a README: name the page and its path"
        for name in re.findall(r"[\w./]+\.md", text):
            assert (ROOT / name).is_file() or (ROOT / "kr270_milling" / name).is_file(), f"{path.name}: {name}"
