"""One line of G-code as words: comments apart, letters with their numbers, and what is no word."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import cast

__all__ = ["Block", "CommentError", "SIMPLE", "WORD", "split_comments", "tokens"]

NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)"
WORD = re.compile(rf"([A-Z])[ \t]*({NUMBER})")
SIMPLE = re.compile(rf"(?:[ \t]*[A-Z][ \t]*{NUMBER})*[ \t]*")  # a line of ISO words alone
NAMED = re.compile(r"[A-Z_]{2,}[0-9]*[ \t]*$")  # what stands before the bracket of a call: CYCLE800(
BLANK = re.compile(r"[ \t]*")
CALL = re.compile(r"([A-Z_]{2,}[0-9_]*)[ \t]*\(([^()]*)\)")
ASSIGNED = re.compile(
    rf"([A-Z][A-Z0-9_]{{0,15}})[ \t]*=[ \t]*(?:(AC|IC|DC)[ \t]*\([ \t]*({NUMBER})[ \t]*\)|({NUMBER})|(\"[^\"]*\"))"
)
NAME = re.compile(r"([A-Z_]{2,}[A-Z0-9_]*)(?![A-Z0-9_]*[ \t]*=)")
LETTER = re.compile(r"([A-Z])[-+.]*(?![A-Z0-9])")
MACRO = re.compile(r"[#\[\]<]|O[ \t]*<|\bR[0-9]+[ \t]*=")
PART = re.compile(r"\S+|.", re.DOTALL)


class CommentError(ValueError):
    """A bracket that is opened and not closed."""


@dataclass
class Block:
    """What one line says beyond plain words."""

    words: list[tuple[str, float]] = field(default_factory=list)
    absolute: dict[str, bool] = field(default_factory=dict)  #: letter -> True for X=AC(..), False for X=IC(..)
    names: list[tuple[str, str | None]] = field(default_factory=list)  #: SUPA, MSG("..") with its argument
    tool: str = ""  #: T="MILL_10"
    machine: list[str] = field(default_factory=list)  #: axes of the machine, Z1=0
    macro: str = ""  #: where an expression begins
    rest: str = ""  #: the first piece that is no word
    bare: str = ""  #: a letter without a number


def split_comments(line: str) -> tuple[str, list[str]]:
    """Code and comments of a line: in brackets, also nested, and after a semicolon; CYCLE800(...) is code."""
    code, at = "", 0
    comments: list[str] = []
    while at < len(line):
        mark = min((i for i in (line.find("(", at), line.find(";", at)) if i >= 0), default=-1)
        if mark < 0:
            return code + line[at:], comments
        code += line[at:mark]
        if line[mark] == ";":
            comments.append(line[mark + 1 :].strip())
            return code, comments
        end = _closing(line, mark)
        if NAMED.search(code.upper()):
            code += line[mark : end + 1]
        else:
            comments.append(line[mark + 1 : end].strip())
            code += " "
        at = end + 1
    return code, comments


def _closing(line: str, start: int) -> int:
    """Where the bracket of ``start`` closes; the first one where they do not pair."""
    depth = 0
    for match in re.finditer(r"[()]", line[start : start + 2000]):
        depth += 1 if match.group() == "(" else -1
        if depth == 0:
            return start + match.start()
    first = line.find(")", start)
    if first < 0:
        raise CommentError("a comment is opened with ( but not closed")
    return first


def tokens(line: str) -> Block:
    """The pieces of an upper-case line that is more than ISO words; reading stops at what cannot be a word."""
    block, at = Block(), 0
    while at < len(line):
        at = _run(BLANK, line, at).end()
        if at == len(line):
            break
        step = _token(line, at, block)
        if step == at:
            break
        at = step
    return block


def _run(pattern: re.Pattern, line: str, at: int) -> re.Match:
    """What a pattern takes at a place; one that may take nothing, so that it always fits."""
    return cast(re.Match, pattern.match(line, at))


def _token(line: str, at: int, block: Block) -> int:
    """The end of the piece at ``at``, noted in the block; ``at`` itself where reading must stop."""
    if MACRO.match(line, at):
        block.macro = _run(PART, line, at).group()
        return at
    if match := CALL.match(line, at):
        block.names.append((match.group(1), match.group(2)))
        return match.end()
    if match := ASSIGNED.match(line, at):
        _assign(match, block)
        return match.end()
    if match := WORD.match(line, at):
        block.words.append((match.group(1), float(match.group(2))))
        return match.end()
    if match := NAME.match(line, at):
        block.names.append((match.group(1), None))
        return match.end()
    if match := LETTER.match(line, at):
        if MACRO.match(line, _run(BLANK, line, match.end()).end()) or line[match.end() : match.end() + 1] == "=":
            block.macro = _run(PART, line, at).group()
        else:
            block.bare = match.group()
        return at
    block.rest = _run(PART, line, at).group()
    return at


def _assign(match: re.Match, block: Block) -> None:
    name, mode, inner, number, text = match.groups()
    if text is not None:
        if name == "T":
            block.tool = text.strip('"').strip()
        return
    value = float(inner or number)
    if name in ("CR", "TURN"):
        block.words.append((name, value))
    elif len(name) == 1:
        if name == "R":
            block.macro = match.group()
        block.words.append((name, value))
        if mode in ("AC", "IC"):
            block.absolute[name] = mode == "AC"
    elif name[0] in "SM" and name[1:].isdigit():
        block.words.append((name[0], value))
    elif name[0] in "XYZ" and name[1:].isdigit():
        block.machine.append(name[0])
    elif name[0] == "R" and name[1:].isdigit():
        block.macro = match.group()
    else:
        block.names.append((name, match.group()))
