"""The table of JSON keys, ``guide/contributing/json.md``: keys of answers and columns of records that have no row."""

import contextlib
import re
import typing
from collections.abc import Iterator
from dataclasses import is_dataclass
from pathlib import Path

from kr270_milling.base.column import columns

PAGE = Path(__file__).parents[1] / "kr270_milling" / "guide" / "contributing" / "json.md"
RECORD = re.compile(r"\[[^]]*\]\(#([a-z0-9-]+)\)")


def read_page() -> dict[str, dict[str, str]]:
    """Record or command -> key -> record of its values, or "" for plain values; "<name>" is any key."""
    tables: dict[str, dict[str, str]] = {}
    above: dict[str, list[str]] = {}
    names: list[str] = []
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if line.startswith("### "):
            title = line[4:].strip()
            names = ["any"] if title.startswith("Any") else title.replace(" ", "-").split(",-")
            for name in names:
                tables[name], above[name] = {}, []
        elif line.startswith("The keys of"):
            for name in names:
                above[name] += RECORD.findall(line)
        elif line.startswith("| `"):
            keys, _, meaning = line.strip("| ").partition(" | ")
            record = RECORD.findall(meaning.partition("→")[2])
            for name in names:
                tables[name] |= dict.fromkeys(re.findall(r"`([^`]+)`", keys), record[0] if record else "")
    for name, others in above.items():
        for other in others:
            tables[name] = tables[other] | tables[name]
    return tables


TABLES = read_page()
_command = [""]  # whose answer is printed now


def keys_of(kind: type) -> set[str]:
    """Return the keys that ``as_dict`` writes for a record of a class, those of its flattened records with them."""
    types = typing.get_type_hints(kind)
    inner = [types.get(c.name) for c in columns(kind) if c.key == "*"]
    keys = {c.key for c in columns(kind)} - {"", "*"}
    return keys.union(*(keys_of(record) for record in inner if is_dataclass(record)))


@contextlib.contextmanager
def answer_of(command: str) -> Iterator[None]:
    """Name the command whose answers are printed inside."""
    before, _command[0] = _command[0], command
    try:
        yield
    finally:
        _command[0] = before


@contextlib.contextmanager
def every_answer_is_in_the_table() -> Iterator[None]:
    """Compare every answer that a command prints as JSON with the table, whatever test runs the command.

    A test that prints an answer without ``cli`` names its command by ``answer_of``; otherwise the test fails.
    """
    from kr270_milling import cli
    from kr270_milling.show.commands import console

    run, print_json = cli._run, console.print_json

    def compared_run(argv):
        with answer_of(argv[0] if argv and argv[0] in TABLES else ""):
            return run(argv)

    def compared_print(value):
        assert _command[0], "an answer of an unknown command: print it inside json_keys.answer_of"
        missing = sorted(set(without_row(value, _command[0])))
        assert not missing, f"{PAGE.name} has no row for {missing}"
        print_json(value)

    cli._run, console.print_json = compared_run, compared_print
    try:
        yield
    finally:
        cli._run, console.print_json = run, print_json


def without_row(value, record: str) -> Iterator[str]:
    """Yield the keys of an answer that have no row in the table of a command or record."""
    rows = TABLES[record]
    for one in value if isinstance(value, (list, tuple)) else [value]:
        for key, inner in one.items() if isinstance(one, dict) else ():
            by_name = next((row for row in rows if row.startswith(f"{key}.<")), None)
            row = key if key in rows else by_name or next((r for r in rows if r.startswith("<")), None)
            if row is None:
                yield f"{record}: {key}"
                continue
            for part in inner.values() if by_name and isinstance(inner, dict) else [inner]:
                yield from _inside(part, rows[row], f"{record}: {key}")


def _inside(value, record: str, where: str) -> Iterator[str]:
    if record:
        yield from without_row(value, record)
    elif isinstance(value, dict) and value:
        yield f"{where}: has keys of no record"
    elif isinstance(value, (list, tuple)):
        for one in value:
            yield from _inside(one, "", where)
