"""``kr270_milling keys``: every key of a cell file with unit, range, default and meaning."""

from __future__ import annotations

from kr270_milling.commands.console import Answer
from kr270_milling.commands.options import option


def add_arguments(parser) -> None:
    option(parser, "section SECTION", "for example tool; default: all", default="", nargs="?")
    option(parser, "--markdown", "print a table for a page", bool)


def run(args) -> Answer:
    from kr270_milling.cell.keys import keys_of

    found = keys_of(args.section)
    rows = [("key", "unit", "range", "default", "meaning")]
    for k in found:
        rows.append((k["key"], k["unit"], k["range"], "required" if k["required"] else _shown(k["default"]), k["text"]))
    if args.markdown:
        cells = [[f"`{row[0]}`", *(text.replace("|", "or") for text in row[1:])] for row in rows]
        cells[0][0] = "key"
        lines = ["| " + " | ".join(row) + " |" for row in [cells[0], ["---"] * 5, *cells[1:]]]
    else:  # whole, however wide the terminal is: a key is to be copied
        widths = [*(max(len(row[column]) for row in rows) for column in range(4)), 0]
        lines = ["  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    return Answer({"section": args.section, "keys": found}, lines)


def _shown(default) -> str:
    if default is None:
        return "-"
    if isinstance(default, list):
        return "[" + ", ".join(map(_shown, default)) + "]"
    if isinstance(default, float):
        return f"{default:g}"
    return str(default).lower() if isinstance(default, bool) else str(default) or '""'
