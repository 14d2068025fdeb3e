"""Lists of groups in parameter files: ``[{a: 1.0}, {a: 2.0}]`` is to a ROS node ``{a: [1.0, 2.0]}``."""

from __future__ import annotations

from kr270_milling.base.errors import ConfigError

__all__ = ["as_lists"]


def as_lists(tree, file, key: str = ""):
    """The tree with every list of groups as one group of lists, row after row; raises ConfigError."""
    if isinstance(tree, dict):
        return {name: as_lists(value, file, f"{key}.{name}".lstrip(".")) for name, value in tree.items()}
    if isinstance(tree, list) and tree and all(isinstance(row, dict) for row in tree):
        return _columns(tree, file, key)
    return tree


def _columns(rows: list[dict], file, key: str) -> dict[str, list]:
    sizes = [{name: len(value) if isinstance(value, list) else 0 for name, value in row.items()} for row in rows]
    if any(size != sizes[0] for size in sizes):
        raise ConfigError(file, key, None, "must have the same keys in every group, with as many numbers each")
    columns: dict = {name: [] for name in rows[0]}
    for row in rows:
        for name, value in row.items():
            columns[name].extend(value if isinstance(value, list) else [value])
    return columns
