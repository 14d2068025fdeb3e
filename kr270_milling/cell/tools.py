"""The ``tools`` of a parameter file: one tree of parameters for each tool, in the order of the program."""

from __future__ import annotations

from collections.abc import Sequence

from kr270_milling.base.errors import ConfigError
from kr270_milling.base.parameter_file import merge
from kr270_milling.path.source_program import SourceProgram

__all__ = ["in_program_order", "tool_trees"]

#: sections that a tool may override; its other keys are those of ``tool``
SECTIONS = ("compensation", "cutting", "dynamics", "exchange", "limits", "mount", "part", "program", "stock", "timing")


def tool_trees(tree: dict, file) -> dict[str, dict]:
    """The trees of a cell for each of its ``tools``, by name; raises ConfigError."""
    tools, path = tree["tools"], tree.get("path")
    if not isinstance(tools, dict) or not tools or not all(isinstance(entry, dict) for entry in tools.values()):
        raise ConfigError(file, "tools", None, "must have a group of keys for each tool, for example T1: {teeth: 2}")
    if not isinstance(path, dict) or not path.get("file"):
        raise ConfigError(file, "tools", None, "needs a program in path.file")
    chosen = path.get("tool", "")
    if chosen and chosen not in tools:
        raise ConfigError(file, "path.tool", chosen, f"one of {', '.join(tools)}")
    return {name: _tree_of_tool(tree, name, file) for name in tools}


def _tree_of_tool(tree: dict, name: str, file) -> dict:
    entry = tree["tools"][name]
    if isinstance(entry.get("stock"), dict) and {"min_mm", "max_mm"} & set(entry["stock"]):
        raise ConfigError(file, f"tools.{name}.stock", None, "must not have min_mm, max_mm: the tools share one stock")
    sections = {key: value for key, value in entry.items() if key in SECTIONS}
    tool = {key: value for key, value in entry.items() if key not in SECTIONS}
    above = {**sections, "tool": tool, "path": {"tool": name}}
    return merge({key: value for key, value in tree.items() if key != "tools"}, above)


def in_program_order(names: Sequence[str], program: SourceProgram, file) -> list[str]:
    """The names of the tools by their first line in the program; file: of the cell.

    Raises ConfigError where the program cuts with a tool that has no name here, or where a tool cuts again after
    another one.
    """
    cutters = sorted((tool for tool in program.tools if tool.cuts), key=lambda tool: tool.line)
    for tool in cutters:
        if tool.name not in names:
            raise ConfigError(file, f"tools.{tool.name}", None, f"is missing: the program cuts with {tool.label}")
    for tool, following in zip(cutters, cutters[1:], strict=False):
        if tool.last_cut > following.line:
            reason = f"cuts again in line {tool.last_cut}, after {following.name}: post a program that uses it once"
            raise ConfigError(file, f"tools.{tool.name}", None, reason)
    return [tool.name for tool in cutters]
