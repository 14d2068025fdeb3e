"""``kr270_milling rsi``: correct a running robot program over KUKA RobotSensorInterface (UDP)."""

from __future__ import annotations

import math
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path

from kr270_milling.base.arguments import STOPS
from kr270_milling.base.errors import InputError
from kr270_milling.base.files import fresh_directory
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell_file import cell_text, read_cell
from kr270_milling.cell.models import arm_of
from kr270_milling.live.rsi.corrector import Corrector, read_corrections
from kr270_milling.live.rsi.session import RsiRecording, RsiSession, open_socket, real_time
from kr270_milling.live.rsi.telegram import Elements, read_elements
from kr270_milling.show.commands.console import Answer, command_line, shown_path


def run_rsi(args) -> Answer:

    table = read_corrections(_table(args.file))
    limits = 1e-3 * args.max_mm, math.radians(args.max_deg), 1e-3 * args.rate_mm_per_s
    corrector = Corrector(table, 1e-3 * args.cycle_ms, *limits, args.ramp_s, 1e-3 * args.reach_mm)
    elements = read_elements(args.context) if args.context else Elements()
    attached: dict[str, bytes | str] = {}
    arm = None
    if not args.cell and (elements.of_joints or not (elements.actual or elements.commanded)):
        raise InputError("--cell", f"is needed, as {args.context} has joints and not places")
    if args.cell:
        cell = read_cell(find_file(args.cell))
        arm = arm_of(cell)
        attached = {"cell.yaml": cell_text(cell)} | {
            Path(file).name: Path(file).read_bytes() for file in cell.path.files
        }
    directory = fresh_directory(args.out)
    metadata = {"command_line": command_line(args)}
    with (
        open_socket(args.host, args.port) as connection,
        RsiRecording(directory, table, metadata, attached, time.time_ns) as recording,
    ):

        def report(sentence: str) -> None:
            print(sentence, file=sys.stderr, flush=True)
            recording.note(sentence)

        session = RsiSession(
            connection, corrector, args.cycle_ms, report, recording.add, args.progress == "rist", elements, arm
        )
        session.rehearse()
        report(f"waiting for the robot on {args.host}:{connection.getsockname()[1]}, UDP")
        if args.host.startswith("127."):
            report("no controller reaches this address: give that of this host in its network with --host")
        ended: list[int] = []

        def end(number: int, _) -> None:
            ended.append(number)
            session.stop.set()  # between two answers

        with suppress(ValueError):  # only the main thread may
            for number in STOPS:
                signal.signal(number, end)
        with real_time() as refused:
            if refused:
                report(refused)
            session.run()
    share = corrector.path.progress / corrector.path.length
    result = {
        "answered": session.answered,
        "late": session.late,
        "missed_cycles": session.missed,
        "repeated": session.repeated,
        "ignored": session.refused,
        "most_delay": session.most_delay,
        "longest_answer_ms": 1e3 * session.longest,
        "mean_answer_ms": 1e3 * session.total / max(session.answered, 1),
        "limited_cycles": corrector.limited,
        "path_share": share,
        "recording": str(directory),
    }
    shown = [
        f"{session.answered} cycles answered, {session.late} later than {args.cycle_ms} ms, {session.missed} missed, "
        f"{session.refused} telegrams ignored",
        f"answer after {result['mean_answer_ms']:.2f} ms in the mean, {result['longest_answer_ms']:.2f} ms at most; "
        f"largest Delay that the robot reported: {session.most_delay}",
        f"{100 * share:.1f} % of the path; limits reduced the correction in {corrector.limited} cycles",
        f"recording: {shown_path(directory)}",
    ]
    code = int(bool(session.late or session.missed or session.recording_failed))
    return Answer(result, shown, code=128 + ended[0] if ended and ended[0] != signal.SIGINT else code)


def _table(name: str) -> Path:
    """Return the table of offsets: the file, or the only one of a directory."""
    path = Path(name)
    if not path.is_dir():
        return path
    tables = sorted(path.glob("rsi_offsets_*.csv"))
    if len(tables) != 1:
        reason = f"holds {len(tables)} tables rsi_offsets_*.csv" + (
            "; name one of them" if tables else ": kr270_milling compensate --write rsi writes one"
        )
        raise InputError(path, reason)
    return tables[0]
