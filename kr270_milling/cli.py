"""The command ``kr270_milling``: names, one line of help each, and the import of the command that was chosen."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import json
import os
import re
import shlex
import signal
import sys
import warnings
from typing import NamedTuple

from kr270_milling.base.arguments import Parser, UsageError
from kr270_milling.base.errors import MillingError, one_line
from kr270_milling.base.version import __version__

__all__ = ["COMMANDS", "Entry", "main"]

EXIT_OK, EXIT_USAGE, EXIT_INTERRUPTED = 0, 2, 130


class Entry(NamedTuple):
    """A command that is not imported yet."""

    module: str  #: of ``commands``, with its options
    text: str  #: line of help

    def load(self, name: str):
        """Import the module and return the command."""
        return importlib.import_module(f"kr270_milling.show.commands.{self.module}").COMMANDS[name]


COMMANDS = {
    "demo": Entry("demo", "run the paper's case: original pass and compensations, tables and report"),
    "init": Entry("cells", "print a first cell file for a program"),
    "keys": Entry("cells", "list the keys of a cell file with unit, range, default and meaning"),
    "run": Entry("run", "run the passes of a cell as ROS 2 nodes, each recorded to MCAP"),
    "simulate": Entry("simulate", "simulate one pass of a cell"),
    "compensate": Entry("compensate", "revise the trajectory of a cell; tables, report and robot programs"),
    "check": Entry("simulate", "say whether a path, or its corrected trajectory, may be run"),
    "stiffness": Entry("cells", "pose, stiffness and natural frequencies of an arm at one posture"),
    "stability": Entry("stability", "limit depth of cut and chatter frequency over spindle speed"),
    "map": Entry(
        "studies", "where to clamp the part and how to turn the tool: reach, limits and predicted error over placements"
    ),
    "sweep": Entry("studies", "full passes with other values of any keys, on as many cores as there are"),
    "identify": Entry("identify", "find compliances, force coefficients and modes from measurements of the own cell"),
    "compare": Entry("identify", "set a measured pass beside the simulated one"),
    "rsi": Entry("rsi", "correct a running robot program over KUKA RobotSensorInterface"),
    "info": Entry("recordings", "show what a recording holds"),
    "replay": Entry("replay", "play a recording back onto topics, recompute it bit for bit, or compensate from it"),
    "export": Entry("recordings", "write the topics of a recording as tables"),
    "report": Entry("recordings", "make the report of one or several recordings"),
    "recover": Entry("recordings", "make a whole recording of one that was cut off or damaged"),
}


def main(argv: list[str] | None = None) -> int:
    """Return exit code 0, 1 (a check failed), 2 (unusable input: one sentence on stderr) or 130 (Ctrl-C).

    Without ``argv`` the process ends here: a key pressed while Python shuts down would change the exit code.
    """
    if argv is not None:
        return _main(argv)
    from kr270_milling.base.process import end_process, exit_code

    if not sys.warnoptions:  # a warning of Python is no sentence for the user; the tests make every one an error
        warnings.simplefilter("ignore")
    try:
        code = _main(sys.argv[1:], own_process=True)
    except SystemExit as error:  # argparse, or a run that SIGTERM ends
        code = exit_code(error)
    return end_process(code)


def _main(argv: list[str], own_process: bool = False) -> int:
    try:
        _handle_interrupts(own_process)
        return _run(argv)
    except BrokenPipeError:  # the reader of the output, head for example, has ended
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_OK
    except MillingError as error:
        return _refuse(argv, str(error), listing=getattr(error, "listing", ()))
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _refuse(argv, f"{where}{error.strerror or error}")
    except MemoryError:
        advice = "a larger stock.grid_step_um or a shorter path needs less"
        return _refuse(argv, f"there is not enough memory for this; {advice}")
    except KeyboardInterrupt:
        return _refuse(argv, "interrupted", EXIT_INTERRUPTED)
    except SystemError as error:  # compiled code that received Ctrl-C or SIGTERM
        end = _end_behind(error)
        if end is None:
            raise
        if isinstance(end, SystemExit):
            raise end from None
        return _refuse(argv, "interrupted", EXIT_INTERRUPTED)


def _end_behind(error: BaseException | None) -> BaseException | None:
    """Return the Ctrl-C or SIGTERM that caused the error: each compiled function that it passes adds a SystemError."""
    while error is not None and not isinstance(error, (KeyboardInterrupt, SystemExit)):
        error = error.__cause__
    return error


def _refuse(argv: list[str], sentence: str, code: int = EXIT_USAGE, listing: tuple[str, ...] = ()) -> int:
    """Print the sentence on standard error, or with ``--json`` as an object on standard output; return the code.

    listing: the parts of the sentence, each for a separate line.
    """
    if "--json" in argv:
        print(json.dumps({"error": one_line(sentence), "exit_code": code}, indent=2))
        return code
    for line in listing or (sentence,):
        print(f"kr270_milling: {one_line(line)}", file=sys.stderr)
    return code


def _handle_interrupts(own_process: bool = False) -> None:
    """Let Ctrl-C, SIGTERM and SIGHUP wait for the end of a compilation, an import or a finalizer, the second time not.

    SIGTERM and SIGHUP end the command as an error does, so that no unfinished file stays. Handlers of a caller stay;
    own_process: there is no caller, and the handler of the start (``__main__``) is replaced.

    An interrupted compiler stays incomplete, and compiled libraries report an interrupted import as a broken
    installation.
    """
    received: list[int] = []

    def end(number, frame):
        received.extend([number] * (number != signal.SIGALRM))
        compiler = sys.modules.get("numba.core.compiler_lock")
        busy = _cannot_end(frame) or (compiler is not None and compiler.global_compiler_lock.is_locked())
        if busy and len(received) < 2:
            signal.signal(signal.SIGALRM, end)
            signal.setitimer(signal.ITIMER_REAL, 0.02)  # look again
            return
        for stop in (signal.SIGTERM, signal.SIGHUP):
            if stop in received:
                raise SystemExit(128 + stop)
        raise KeyboardInterrupt

    with contextlib.suppress(ValueError):  # only the main thread may
        present = signal.getsignal(signal.SIGINT)
        if present is signal.default_int_handler or (own_process and present is not signal.SIG_IGN):
            signal.signal(signal.SIGINT, end)
        for stop in (signal.SIGTERM, signal.SIGHUP):  # nohup ignores SIGHUP: then it stays ignored
            if signal.getsignal(stop) is signal.SIG_DFL:
                signal.signal(stop, end)


def _complete() -> None:
    """Complete a line for the shell: eval "$(register-python-argcomplete kr270_milling)"."""
    with contextlib.suppress(ImportError, ValueError):  # not installed; a quote that is still open
        import argcomplete

        words = shlex.split(os.environ.get("COMP_LINE", ""))[1:]
        argcomplete.autocomplete(_parser(words))


def _cannot_end(frame) -> bool:
    """Whether an import or a finalizer runs. Python prints an exception in a finalizer and continues."""
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>" or frame.f_code.co_name == "__del__":
            return True
        frame = frame.f_back
    return False


def _run(argv: list[str]) -> int:
    if "_ARGCOMPLETE" in os.environ:
        _complete()
    argv = _join_negative(argv)
    if any("\0" in word for word in argv):  # a caller of main can pass one, a shell cannot
        raise UsageError("an argument contains a zero byte")
    parser = _parser(argv)
    if not argv:
        parser.print_help()
        return EXIT_OK
    args = parser.parse_args(argv)
    args.argv = argv
    if hasattr(sys.stdout, "reconfigure"):  # a file name need not be text that can be printed
        sys.stdout.reconfigure(errors="backslashreplace")
    answer = args.run(args)
    return answer if isinstance(answer, int) else answer.print(args.json)


def _join_negative(argv: list[str]) -> list[str]:
    """``--wrench -1,2`` as ``--wrench=-1,2``: argparse takes a list or range that starts with a minus for an option."""
    joined: list[str] = []
    for word in argv:
        if joined and re.match(r"--[a-z][a-z-]*$", joined[-1]) and re.match(r"-[0-9.][^ ]*[,:]", word):
            joined[-1] += "=" + word
        else:
            joined.append(word)
    return joined


def _parser(argv: list[str]) -> argparse.ArgumentParser:
    width = max(map(len, COMMANDS)) + 2
    listing = "\n".join(f"  {name:{width}}{entry.text}" for name, entry in COMMANDS.items())
    parser = Parser(
        prog="kr270_milling",
        description="Predict and compensate the compliance errors of robotic milling.",
        epilog=f"commands:\n{listing}\n\nexample: kr270_milling demo --out out",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("-V", "--version", action="version", version=f"kr270_milling {__version__}")
    sub = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    chosen = next((a for a in argv if not a.startswith("-")), None)
    for name, entry in COMMANDS.items():
        if name == chosen:
            from kr270_milling.show.commands.command import add_command

            add_command(sub, name, entry.text, entry.load(name))
        else:
            sub.add_parser(name)
    return parser


if __name__ == "__main__":
    sys.exit(main())
