"""The command ``kr270_milling``: one sub-command a job. Only the chosen one is imported, so ``--help`` is quick."""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import shlex
import signal
import sys

from kr270_milling import __version__
from kr270_milling.commands.command import add_command
from kr270_milling.commands.options import COMMANDS

__all__ = ["main"]

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
        return EXIT_USAGE if error.printed else _refuse(str(error), getattr(error, "listing", ()))


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
    listing = "\n".join(f"  {name:{width}}{command.text}" for name, command in COMMANDS.items())
    parser = argparse.ArgumentParser(
        prog="kr270_milling",
        description="Predict and compensate the compliance errors of robotic milling.",
        epilog=f"commands:\n{listing}\n\nexample: kr270_milling demo --out out",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"kr270_milling {__version__}")
    sub = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    chosen = next((a for a in argv if not a.startswith("-")), None)
    for name, command in COMMANDS.items():
        add_command(sub, name, command, filled=name == chosen)
    return parser


if __name__ == "__main__":
    sys.exit(main())
