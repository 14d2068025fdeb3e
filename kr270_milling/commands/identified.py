"""How every ``identify`` command and ``compare`` end: one object for --json, tables, sentences, files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from kr270_milling.commands.console import print_json, print_table

__all__ = ["Outcome", "Table", "report"]


@dataclass(frozen=True)
class Table:
    """As ``print_table`` takes it."""

    title: str
    columns: list[str]
    rows: list[list[str]]


@dataclass(frozen=True)
class Outcome:
    """What a command says."""

    name: str  #: of its files
    title: str
    result: dict  #: for --json
    tables: list[Table]
    said: list[str]  #: sentences


def report(args, outcome: Outcome, figures=None, sections: dict | None = None, source: str = "", use: str = "") -> None:
    """Print; with --out also write a page with the figures, and the sections as a parameter file to include.

    figures: a function, since only --out needs them; source: what the title leaves open; use: how to include the file.
    """
    result = outcome.result
    if args.out:
        result["files"] = [str(path) for path in _write(args.out, outcome, figures, sections, source, use)]
    if args.json:
        print_json(result)
        return
    for table in outcome.tables:
        print_table(table.title, table.columns, table.rows)
    for line in (*outcome.said, *result.get("files", [])):
        print(line)


def _write(out: str, outcome: Outcome, figures, sections, source: str, use: str) -> list[Path]:
    from kr270_milling import __version__
    from kr270_milling.base.files import staged
    from kr270_milling.base.include import write_include
    from kr270_milling.identification.figures import write_page

    notes = [f"{outcome.title}, identified by kr270_milling {__version__}{source}", *outcome.said, use]
    with staged(out) as (draft, final):
        files = []
        if sections is not None:
            files.append(write_include(draft / f"{outcome.name}.yaml", sections, notes))
        if figures is not None:
            tables = [(table.title, table.columns, table.rows) for table in outcome.tables]
            page = draft / f"{outcome.name}.html"
            files.append(write_page(page, outcome.title, outcome.said, tables, figures()))
        return [final(path) for path in files]
