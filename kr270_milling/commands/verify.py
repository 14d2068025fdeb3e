"""``kr270_milling verify``: the verification book. Exit code 1 if a check fails."""

from __future__ import annotations

import time

from kr270_milling.commands.console import add_common, print_json, progress


def add_arguments(parser) -> None:
    parser.add_argument("--only", metavar="NAME", help="only the checks whose name contains this")
    parser.add_argument("--markdown", action="store_true", help="print a table in Markdown")
    add_common(parser)


def run(args) -> int:
    from kr270_milling import verification

    checks, start = verification.chosen(args.only), time.perf_counter()
    outcomes = []
    with progress("verifying") as report:
        for done, one in enumerate(checks, 1):
            outcomes.append(verification.run(one))
            report(done, len(checks))
    seconds = time.perf_counter() - start
    failed = sum(o.verdict == "FAILED" for o in outcomes)
    if args.json:
        print_json({"checks": [_entry(o) for o in outcomes], "failed": failed, "wall_s": seconds})
    else:
        _print(outcomes, args.markdown, seconds)
    return 1 if failed else 0


def _entry(outcome) -> dict:
    one = outcome.check
    return {
        "name": one.name,
        "expected": outcome.expected,
        "at_most": one.at_most,
        "source": one.source,
        "got": outcome.got,
        "tolerance": outcome.tolerance,
        "unit": one.unit,
        "verdict": outcome.verdict,
        "reason": outcome.reason,
    }


def _cells(outcome) -> list[str]:
    """Name, expected, got, tolerance, verdict, source as text; numbers with so many digits that the verdict shows."""
    one = outcome.check
    unit = f" {one.unit}" if one.unit else ""
    if outcome.reason:
        return [one.name, "", "", "", outcome.verdict, f"{one.source}; {outcome.reason}"]
    bound = "<= " if one.at_most else ""
    return [
        one.name, f"{bound}{outcome.expected:.5g}{unit}", f"{outcome.got:.5g}", f"{outcome.tolerance:.2g}",
        outcome.verdict, one.source,
    ]  # fmt: skip


def _print(outcomes, markdown: bool, seconds: float) -> None:
    rows = [_cells(o) for o in outcomes]
    if markdown:
        columns = ["check", "expected", "got", "tolerance", "verdict", "source of the expected value"]
        for row in (columns, ["---"] * len(columns), *rows):
            print("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |")
    else:  # two lines a check: a table of this width would be cut off
        for name, expected, got, tolerance, verdict, source in rows:
            print(f"{verdict:8} {name}")
            print(f"         {f'{got} for {expected}, tolerance {tolerance}; ' if got else ''}{source}")
    print()
    verdicts = [o.verdict for o in outcomes]
    count = ", ".join(f"{verdicts.count(v)} {v}" for v in ("ok", "FAILED", "skipped"))
    print(f"{len(outcomes)} checks: {count}; {seconds:.1f} s")
