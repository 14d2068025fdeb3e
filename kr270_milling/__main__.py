"""``python -m kr270_milling`` and the program ``kr270_milling``: the command line."""

import gc
import os
import signal


def _end(*_) -> None:
    """End at once: no file is open yet."""
    os.write(2, b"kr270_milling: interrupted\n")
    os._exit(130)


if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # before the imports, which take longest
    signal.signal(signal.SIGINT, _end)


def run_program() -> int:
    """Run the command of the command line; end this process."""
    from kr270_milling.base.arguments import one_thread_each

    one_thread_each(os.environ)
    gc.set_threshold(20_000, 20)  # of the first command, which compiles, collections took 1.1 of 13 s
    from kr270_milling.cli import main

    return main()


if __name__ == "__main__":
    raise SystemExit(run_program())
