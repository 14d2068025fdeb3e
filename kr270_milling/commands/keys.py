"""``kr270_milling keys``: every key of a cell file with unit, range, default and meaning."""

from __future__ import annotations

from kr270_milling.commands.console import add_common, print_json


def add_arguments(parser) -> None:
    parser.add_argument("section", metavar="SECTION", nargs="?", default="", help="for example tool; default: all")
    parser.add_argument("--markdown", action="store_true", help="print a table for a page")
    add_common(parser)


def run(args) -> None:
    from kr270_milling.cell.keys import keys_of

    found = keys_of(args.section)
    if args.json:
        print_json({"section": args.section, "keys": found})
        return
    rows = [("key", "unit", "range", "default", "meaning")]
    for k in found:
        rows.append((k["key"], k["unit"], k["range"], "required" if k["required"] else _shown(k["default"]), k["text"]))
    if args.markdown:
        cells = [[f"`{row[0]}`", *(text.replace("|", "or") for text in row[1:])] for row in rows]
        cells[0][0] = "key"
        print("\n".join("| " + " | ".join(row) + " |" for row in [cells[0], ["---"] * 5, *cells[1:]]))
        return
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    for row in rows:  # whole, however wide the terminal is: a key is to be copied
        print("  ".join(text.ljust(width) for text, width in zip(row, [*widths, 0], strict=True)).rstrip())


def _shown(default) -> str:
    if default is None:
        return "-"
    if isinstance(default, list):
        return "[" + ", ".join(map(_shown, default)) + "]"
    if isinstance(default, float):
        return f"{default:g}"
    return str(default).lower() if isinstance(default, bool) else str(default) or '""'
