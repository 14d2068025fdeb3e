"""The commands of the pages, and the lines of their output that the pages show.

usage: python test/pages.py [PAGE...] [--update]

The commands of a fenced ``sh`` block run in their order in the directory of the page, a new one with ``config`` in it.
Words behind ``sh``, which a page does not show, change that: ``sh not run: REASON``, or ``sh release: REASON`` for a
block that takes long or needs other processes. This script runs the blocks for a release, the tests leave them out.
A reason with "exit code 1" states that the commands end so. A block that installs the package is not run: .ci/run and
.ci/pages start with these commands of the README.

A fenced ``output`` block shows lines that the block of commands before it prints, in their order. A line
that ends in " ..." shows the beginning of a line; a line "..." replaces others. Numbers agree within 1 % or one unit
of their last digit.

The script runs the pages with the programs in the folder of this interpreter, prints the shown lines that were not
printed, and ends with 1 if there are any. With ``--update`` it writes the printed lines into the pages instead, for
each shown line the one that resembles it most, and names the lines that no printed line resembles. The table of keys
is written from the records that check a cell.
"""

import contextlib
import difflib
import io
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = (
    ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "kr270_milling/guide").rglob("*.md")),
    *sorted(page for folder in ("config", "test") for page in (ROOT / folder).rglob("README.md")),
)  # fmt: skip
FENCE = re.compile(r"^```(\w*) ?([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"^(cat > (\S+) <<'EOF'\n(.*?)^EOF$|[^\n]+)\n?", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?")
CUT = " ..."
KEYS = "| key | unit | range | default | meaning |\n"


@dataclass
class Block:
    """The commands of one fenced block, and the lines that the page shows of their output."""

    page: Path
    commands: list[str]
    mark: str = ""  #: "", "not run" or "release"
    reason: str = ""
    shown: list[str] = field(default_factory=list)  #: text of each output

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}: {self.commands[0].splitlines()[0]}"


def blocks(page: Path) -> list[Block]:
    """The ``sh`` blocks of a page in their order, each with the outputs that follow."""
    made: list[Block] = []
    for language, words, text in FENCE.findall(page.read_text(encoding="utf-8")):
        if language == "sh":
            if "pip install" in text and not words:
                words = "not run: .ci/run and .ci/pages run it; the lines are those of the demo"
            mark, _, reason = words.partition(":")
            commands = [m[0].rstrip("\n") for m in COMMAND.finditer(text)]
            made.append(Block(page, [line for line in commands if not line.startswith("#")], mark, reason.strip()))
        elif language == "output":
            made[-1].shown.append(text)
    return made


def _signature(line: str) -> str:
    """The words of a line, without its numbers, and without the widths of a table."""
    return " ".join(re.sub(r"[━─]+", "━", NUMBER.sub("#", line)).split())


def _alike(shown: str, printed: str) -> bool:
    if shown.endswith(CUT):
        shown = shown[: -len(CUT)]
        words = len(shown.split())
        printed = " ".join(printed.split()[:words])
    if _signature(shown) != _signature(printed):
        return False
    for a, b in zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True):
        digit = 10.0 ** -len(a.partition("e")[0].partition(".")[2])
        if abs(float(a) - float(b)) > max(1.01 * digit, 0.01 * abs(float(b))):
            return False
    return True


def differences(shown: str, printed: str) -> list[str]:
    """Return the shown lines that were not printed in their order."""
    rest, missing = printed.splitlines(), []
    for line in filter(None, shown.splitlines()):
        at = next((k for k, other in enumerate(rest) if _alike(line, other)), None)
        if at is None and line != CUT.strip():
            missing.append(line)
        elif at is not None:
            rest = rest[at + 1 :]
    return missing


def _likeness(a: str, b: str) -> float:
    return difflib.SequenceMatcher(None, a, b).ratio()


def updated(shown: str, printed: str) -> tuple[str, list[str]]:
    """Return the shown text with the printed lines that resemble its lines, and the lines that none resembles."""
    rest, lines, lost = printed.splitlines(), [], []
    for line in shown.splitlines():
        if not line or line == CUT.strip():
            lines.append(line)
            continue
        ends = rest
        if line.endswith(CUT):
            words = len(line.split()) - 1
            ends = ["".join(re.findall(r"\s*\S+", other)[:words]) + CUT for other in rest]
        ranks = [(_alike(line, other), _likeness(_signature(line), _signature(end)), _likeness(line, end))
                 for other, end in zip(rest, ends, strict=True)]  # fmt: skip
        best = max(range(len(ends)), key=ranks.__getitem__, default=None)
        if best is None or ranks[best][1] < 0.6:
            lines.append(line)
            lost.append(line)
            continue
        lines.append(ends[best])
        rest = rest[best + 1 :]
    return "".join(f"{line}\n" for line in lines), lost


def run_here(command: str, expected: int = 0) -> str:
    """Run a command in this process and directory; return what it prints. Raises RuntimeError at another exit code."""
    from kr270_milling.cli import main

    if file := COMMAND.fullmatch(command)[2]:
        Path(file).write_text(COMMAND.fullmatch(command)[3], encoding="utf-8")
        return ""
    words, _, into = command.partition(" > ")
    program, *arguments = shlex.split(words)
    if program != "kr270_milling":
        raise RuntimeError(f"{command}: no command of kr270_milling; the block needs a mark")
    with contextlib.redirect_stdout(io.StringIO()) as text, contextlib.redirect_stderr(io.StringIO()) as errors:
        code = main(arguments)
    if code != expected:
        raise RuntimeError(f"{command}: exit code {code}\n{errors.getvalue()}")
    if into:
        Path(into).write_text(text.getvalue(), encoding="utf-8")
        return ""
    return text.getvalue()


def run_in_shell(command: str, expected: int = 0) -> str:
    """As ``run_here``, by bash, with the programs beside this interpreter."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    print(f"  $ {command.splitlines()[0]}", flush=True)
    environment = {**os.environ, "PATH": path, "PYTHONUNBUFFERED": "1"}
    done = subprocess.run(["bash", "-c", command], env=environment, stdin=subprocess.DEVNULL, capture_output=True,
                          text=True)  # fmt: skip
    if done.returncode != expected:
        raise RuntimeError(f"{command}: exit code {done.returncode}\n{done.stderr[-2000:]}")
    return done.stdout


def run_page(
    page: Path, run: Callable[[str, int], str] = run_here, release: bool = False
) -> Iterator[tuple[Block, str]]:
    """Run the blocks of a page in this directory; yield each with what it printed. A failure is the text of a block."""
    for block in blocks(page):
        if not block.mark or (release and block.mark == "release"):
            expected = int("exit code 1" in block.reason)
            yield block, "".join(run(command, expected) for command in block.commands)


def directory_of(page: Path, place: Path) -> Path:
    """Make the directory in which the commands of a page run; ``config`` is the only entry."""
    directory = place / str(page.relative_to(ROOT)).replace("/", "_")
    directory.mkdir()
    (directory / "config").symlink_to(ROOT / "config")
    return directory


def key_table() -> str:
    """Return the table of all keys of a cell file."""
    from kr270_milling.cell.keys import keys_of
    from kr270_milling.show.commands.cells import default_text

    lines = [KEYS.rstrip(), "| --- | --- | --- | --- | --- |"]
    for key in keys_of():
        default = "required" if key["required"] else default_text(key["default"])
        texts = (text.replace("|", "or") for text in (key["unit"], key["range"], default, key["text"]))
        lines.append(" | ".join([f"| `{key['key']}`", *texts]) + " |")
    return "\n".join(lines) + "\n"


def main(words: list[str]) -> int:
    update = "--update" in words
    pages = [Path(word).resolve() for word in words if not word.startswith("-")] or list(PAGES)
    failed, home = 0, Path.cwd()
    with tempfile.TemporaryDirectory() as place:
        for page in pages:
            directory = directory_of(page, Path(place))
            text = page.read_text(encoding="utf-8")
            print(page.relative_to(ROOT), flush=True)
            os.chdir(directory)
            try:
                for block, printed in run_page(page, run_in_shell, release=True):
                    for shown in block.shown:
                        new, lost = updated(shown, printed) if update else (shown, differences(shown, printed))
                        text = text.replace(f"```output\n{shown}```", f"```output\n{new}```")
                        for line in lost:
                            print(f"{page.relative_to(ROOT)}: is not printed: {line}")
                        failed += len(lost)
            except RuntimeError as error:
                print(f"{page.relative_to(ROOT)}: {error}")
                failed += 1
            os.chdir(home)
            if update:
                before, header, _ = text.partition(KEYS)
                text = before + (key_table() if header else "")
                page.write_text(text, encoding="utf-8")
    print(f"{failed} differences" if failed else "the pages show what is printed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
