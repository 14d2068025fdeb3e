"""``kr270_milling export``: the topics of a recording as tables."""

from __future__ import annotations

import sys
from pathlib import Path

from kr270_milling.commands.console import EXIT_FAILED, add_common, print_json
from kr270_milling.commands.progress import progress


def add_arguments(parser) -> None:
    parser.add_argument("file", metavar="FILE.mcap|DIR", help="a recording, also one that was cut off")
    parser.add_argument("--csv", metavar="DIR", help="write a CSV file per topic into this directory")
    parser.add_argument("--parquet", metavar="DIR", help="the same as Parquet; needs pyarrow")
    parser.add_argument("--topics", metavar="TOPIC", nargs="+", help="only these")
    add_common(parser)


def run(args) -> int:
    from kr270_milling.bag.export import export_csv, export_parquet
    from kr270_milling.bag.reader import Recording
    from kr270_milling.base.errors import InputError, one_line
    from kr270_milling.base.units import seconds

    if not args.csv and not args.parquet:
        raise InputError("export", "give --csv DIR or --parquet DIR")
    files: list[Path] = []
    refused: dict[str, str] = {}
    with progress("exporting") as report, Recording(args.file, report) as recording:
        for directory, write in ((args.csv, export_csv), (args.parquet, export_parquet)):
            if directory:
                written = write(recording, directory, args.topics, report)
                files += written.files
                refused |= written.refused
        last = recording.last_log_time
    if args.json:
        about = {"file": str(recording.path), "cut_off": recording.cut_off, "files": files, "refused": refused}
        print_json(about)
        return EXIT_FAILED if refused else 0
    if recording.cut_off:
        print(f"{recording.path} was cut off; this is what it holds up to {seconds(last or 0)} s")
    for file in files:
        print(file)
    for sentence in refused.values():
        print("not exported: " + one_line(sentence), file=sys.stderr)
    return EXIT_FAILED if refused else 0
