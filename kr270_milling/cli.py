"""The command ``kr270_milling``: one sub-command a job. Only the chosen one is imported, so ``--help`` is quick."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import os
import re
import shlex
import signal
import sys

from kr270_milling import __version__

__all__ = ["main"]

#: name -> (what it does, example)
COMMANDS = {
    "demo": ("run the paper's case: original pass and three compensations, table and report", "demo --out out"),
    "init": ("print a first cell file for a program", "init --gcode config/test_piece.nc"),
    "keys": ("list the keys of a cell file with unit, range, default and meaning", "keys tool"),
    "run": (
        "run the passes of a cell as ROS 2 nodes, each recorded to MCAP",
        "run config/paper.yaml --method spline --out out",
    ),
    "simulate": ("simulate one pass of a cell", "simulate config/paper.yaml --set path.depth_of_cut_mm=1"),
    "compensate": (
        "revise the trajectory of a cell; tables, report and robot programs",
        "compensate config/test_piece.yaml --out out",
    ),
    "check": ("say whether a path, or its corrected trajectory, may be run", "check config/test_piece.yaml"),
    "stiffness": (
        "pose, stiffness and natural frequencies of an arm at one posture",
        "stiffness config/kr270_2.yaml --joints-deg 90,-50,120,180,25,180",
    ),
    "stability": (
        "limit depth of cut and chatter frequency over spindle speed",
        "stability config/paper.yaml --speeds 4000:12000:100",
    ),
    "map": (
        "where to clamp the part and how to turn the tool: reach, limits and predicted error over placements",
        "map config/test_piece.yaml --x 1200:1800:13 --y=-300:300:7 --tool-turn=-90:90:7",
    ),
    "sweep": (
        "full passes with other values of any keys, on as many cores as there are",
        "sweep config/paper.yaml --vary path.depth_of_cut_mm=0.2:1:0.2 --out sweep",
    ),
    "identify": (
        "find compliances, force coefficients and modes from measurements of the own cell",
        "identify compliance MEASUREMENTS.csv --arm config/kr270_2.yaml",
    ),
    "compare": ("set a measured pass beside the simulated one", "compare out/original config/paper.yaml"),
    "info": ("show what a recording holds", "info out/pass1"),
    "replay": (
        "play a recording back onto topics, recompute it bit for bit, or compensate from it",
        "replay out/pass1 --recompute",
    ),
    "export": ("write the topics of a recording as tables", "export out/pass1 --csv tables"),
    "report": ("make the report of one or several recordings", "report out"),
    "watch": ("show a running graph, live, on a page of this host", "watch --port 8270"),
    "recover": ("make a whole recording of one that was cut off or damaged", "recover out/pass1"),
    "bench": ("time the sweep of the teeth and the stiffness model", "bench"),
}
EXIT_OK, EXIT_USAGE, EXIT_INTERRUPTED = 0, 2, 130


def main(argv: list[str] | None = None) -> int:
    """Exit code 0, 1 (a check failed), 2 (unusable input: one sentence on stderr) or 130 (Ctrl-C).

    Without ``argv`` the process is the command's own, and ends here: a key that comes while Python takes itself apart
    would change an exit code that is due.
    """
    if argv is not None:
        return _main(argv)
    from kr270_milling.base.process import end_process, exit_code

    try:
        code = _main(sys.argv[1:])
    except SystemExit as error:  # argparse, or a run that SIGTERM ends
        code = exit_code(error)
    return end_process(code)


def _main(argv: list[str]) -> int:
    try:
        _hear_interrupts()
        return _run(argv)
    except BrokenPipeError:  # the reader of our output, head for example, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_OK
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _refuse(f"{where}{error.strerror or error}")
    except MemoryError:
        return _refuse("there is not enough memory for this; a larger stock.grid_step_um or a shorter path needs less")
    except KeyboardInterrupt:
        print("kr270_milling: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED


def _hear_interrupts() -> None:
    """Ctrl-C as Python has it, but not in the midst of a compilation or an import: it waits for their end, some seconds
    at most, unless it comes twice. It would leave the compiler half made, and compiled libraries report an interrupt of
    their own import as a broken installation."""
    pressed: list[int] = []

    def interrupt(number, frame):
        pressed.extend([number] * (number == signal.SIGINT))
        compiler = sys.modules.get("numba.core.compiler_lock")
        busy = _is_importing(frame) or (compiler is not None and compiler.global_compiler_lock.is_locked())
        if busy and len(pressed) < 2:
            signal.signal(signal.SIGALRM, interrupt)
            signal.setitimer(signal.ITIMER_REAL, 0.02)  # look again
            return
        raise KeyboardInterrupt

    with contextlib.suppress(ValueError):  # only the main thread may
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, interrupt)


def _complete() -> None:
    """Answer a shell that asks how a line goes on: eval "$(register-python-argcomplete kr270_milling)"."""
    with contextlib.suppress(ImportError, ValueError):  # not installed; a quote that is still open
        import argcomplete

        words = shlex.split(os.environ.get("COMP_LINE", ""))[1:]
        argcomplete.autocomplete(_parser(words))


def _is_importing(frame) -> bool:
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False


def _run(argv: list[str]) -> int:
    if "_ARGCOMPLETE" in os.environ:
        _complete()
    argv = _join_negative(argv)
    if any("\0" in word for word in argv):  # no shell can pass one on, but a caller of main can
        return _refuse("an argument holds a zero byte")
    parser = _parser(argv)
    if not argv:
        parser.print_help()
        return EXIT_OK
    args = parser.parse_args(argv)
    args.argv = argv
    from kr270_milling.base.errors import MillingError

    if hasattr(sys.stdout, "reconfigure"):  # a file name need not be text that can be printed
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        answer = args.run(args)
        return answer if isinstance(answer, int) else answer.tell(args.json)
    except MillingError as error:
        return _refuse(str(error), getattr(error, "listing", ()))


def _refuse(sentence: str, listing: tuple = ()) -> int:
    """The sentence; where an error lists several things, each on a line of its own instead."""
    from kr270_milling.base.errors import one_line

    for line in listing or (sentence,):
        print(f"kr270_milling: {one_line(line)}", file=sys.stderr)
    return EXIT_USAGE


def _join_negative(argv: list[str]) -> list[str]:
    """``--wrench -1,2`` as ``--wrench=-1,2``: argparse takes a list that starts with a minus for an option."""
    joined: list[str] = []
    for word in argv:
        if joined and re.match(r"--[a-z][a-z-]*$", joined[-1]) and re.match(r"-[0-9.][^ ]*,", word):
            joined[-1] += "=" + word
        else:
            joined.append(word)
    return joined


def _parser(argv: list[str]) -> argparse.ArgumentParser:
    width = max(map(len, COMMANDS)) + 2
    listing = "\n".join(f"  {name:{width}}{text}" for name, (text, _) in COMMANDS.items())
    parser = argparse.ArgumentParser(
        prog="kr270_milling",
        description="Predict and compensate the compliance errors of robotic milling.",
        epilog=f"commands:\n{listing}\n\nexample: kr270_milling demo --out out",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"kr270_milling {__version__}")
    sub = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    chosen = next((a for a in argv if not a.startswith("-")), None)
    for name, (text, example) in COMMANDS.items():
        description, epilog = text[0].upper() + text[1:] + ".", f"example: kr270_milling {example}"
        command = sub.add_parser(name, description=description, epilog=epilog)
        if name == chosen:
            from kr270_milling.commands.options import add_json

            module = importlib.import_module(f"kr270_milling.commands.{name}")
            module.add_arguments(command)
            add_json(command)
            command.set_defaults(run=module.run)
    return parser


if __name__ == "__main__":
    sys.exit(main())
