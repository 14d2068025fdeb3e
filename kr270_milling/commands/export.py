"""``kr270_milling export``: topics of a recording as tables."""

from __future__ import annotations

import sys
from pathlib import Path

from kr270_milling.commands.console import Answer
from kr270_milling.commands.options import option
from kr270_milling.commands.progress import progress


def add_arguments(parser) -> None:
    option(parser, "file FILE.mcap|DIR", "a recording, also one that was cut off")
    option(parser, "--csv DIR", "write one CSV file per topic into this directory")
    option(parser, "--parquet DIR", "the same as Parquet; needs pyarrow")
    option(parser, "--topics TOPIC", "only these", nargs="+")


def run(args) -> Answer:
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
    about = {"file": str(recording.path), "cut_off": recording.cut_off, "files": files, "refused": refused}
    for sentence in () if args.json else refused.values():
        print("not exported: " + one_line(sentence), file=sys.stderr)
    cut = [f"{recording.path} was cut off; this is what it holds up to {seconds(last or 0)} s"]
    return Answer(about, [*(cut if recording.cut_off else ()), *files], code=int(bool(refused)))
