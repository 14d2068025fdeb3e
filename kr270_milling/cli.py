"""The command ``kr270_milling``: exit codes, signals, and errors in one sentence."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import shlex
import signal
import sys
import warnings

from kr270_milling.base.arguments import end_process, exit_code
from kr270_milling.base.errors import MillingError, one_line
from kr270_milling.show.commands.options import make_parser, run


def main(argv: list[str] | None = None) -> int:
    """Return exit code 0, 1 (a check failed), 2 (unusable input: one sentence on stderr) or 130 (Ctrl-C).

    Without ``argv`` the process ends here: a key pressed while Python shuts down would change the exit code.
    """
    if argv is not None:
        return _main(argv)
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
        return 0
    except MillingError as error:
        return _refuse(argv, str(error), listing=getattr(error, "listing", ()))
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        if error.errno == errno.ENOSPC:
            from kr270_milling.base.files import write_failure  # its imports take 50 ms of each command

            return _refuse(argv, f"{where}{write_failure(error, error.filename or 'output')}")
        return _refuse(argv, f"{where}{error.strerror or error}")
    except MemoryError:
        advice = "a larger stock.grid_step_um or a shorter path needs less"
        return _refuse(argv, f"there is not enough memory for this; {advice}")
    except KeyboardInterrupt:
        return _refuse(argv, "interrupted", 130)
    except SystemError as error:  # compiled code that received Ctrl-C or SIGTERM
        end = _end_behind(error)
        if end is None:
            raise
        if isinstance(end, SystemExit):
            raise end from None
        return _refuse(argv, "interrupted", 130)


def _end_behind(error: BaseException | None) -> BaseException | None:
    """Return the Ctrl-C or SIGTERM that caused the error: each compiled function that it passes adds a SystemError."""
    while error is not None and not isinstance(error, (KeyboardInterrupt, SystemExit)):
        error = error.__cause__
    return error


def _refuse(argv: list[str], sentence: str, code: int = 2, listing: tuple[str, ...] = ()) -> int:
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
        argcomplete.autocomplete(make_parser(words))


def _cannot_end(frame) -> bool:
    """Return whether an import or a finalizer runs: Python prints an exception in a finalizer and continues."""
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
        raise MillingError("an argument contains a zero byte")
    parser = make_parser(argv)
    if not argv:
        parser.print_help()
        return 0
    args = parser.parse_args(argv)
    args.argv = argv
    if hasattr(sys.stdout, "reconfigure"):  # a file name need not be text that can be printed
        sys.stdout.reconfigure(errors="backslashreplace")
    answer = run(args)
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


if __name__ == "__main__":
    sys.exit(main())
