"""Declare the parameter records as ROS parameters with descriptor and range, and build the records from them."""

from __future__ import annotations

import math

import numpy as np
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, ParameterType
from rclpy.parameter import Parameter

from kr270_milling.base.parameter_file import AXES, DISPLAYED, find_file, from_display, merge, read_tree
from kr270_milling.base.record import Record, Spec, build, flatten, specs
from kr270_milling.cell.cell import Cell, with_program
from kr270_milling.path.cam.readers import find_tool_path

__all__ = ["declare", "declare_cell"]

TYPES = {
    float: Parameter.Type.DOUBLE,
    int: Parameter.Type.INTEGER,
    bool: Parameter.Type.BOOL,
    str: Parameter.Type.STRING,
    np.ndarray: Parameter.Type.DOUBLE_ARRAY,
    tuple: Parameter.Type.STRING_ARRAY,
}
ANY = ParameterDescriptor(dynamic_typing=True)
LARGE = 1e300  # the range message has no infinity that every tool reads


def declare(node, record: type[Record], writable: tuple[str, ...] = ()):
    """Declare every parameter of a record class on a node and return the record.

    Values come from the node's parameter file; where that is silent, from the files named in ``includes``, then from
    the record's defaults. All are read-only but those named in ``writable``. Raises ConfigError with node, key, value
    and allowed range.
    """
    about = ParameterDescriptor(description="parameter files that the values not given here come from", read_only=True)
    names = node.declare_parameter("includes", [""], about).value
    tree: dict = {}
    for name in filter(None, names):
        tree = merge(tree, read_tree(find_file(name)))
    leaves, own = dict(_leaves(record)), {}
    displayed = [f"{group}.{key}.{axis}" for group, (key, _, _) in DISPLAYED.items() for axis in AXES]
    for path in (*leaves, *displayed):
        given = node.declare_parameter(path, None, ANY).value  # the record checks the type: YAML writes 1 for 1.0
        node.undeclare_parameter(path)
        if given is not None:
            *groups, last = path.split(".")
            branch: dict = {last: given if isinstance(given, (str, int, float)) else list(given)}
            for group in reversed(groups):
                branch = {group: branch}
            own = merge(own, branch)
    source = f"parameters of {node.get_fully_qualified_name()}"
    built = build(record, merge(tree, from_display(own, source)), source)
    values = flatten(built)
    for path, spec in leaves.items():
        value: object = values.get(path, [])
        if isinstance(value, list) and not value:  # not given, or an empty list, whose type ROS cannot derive
            value = TYPES[spec.kind]
        node.declare_parameter(path, value, _descriptor(spec, path not in writable), ignore_override=True)
    return built


def declare_cell(node, writable: tuple[str, ...] = ()) -> Cell:
    """The whole cell as parameters of a node; a tool path file may go by the name of a shipped one."""
    cell = declare(node, Cell, writable)
    if cell.path.file:
        cell = cell.replace(path=cell.path.replace(file=str(find_tool_path(cell.path.file))))
    return with_program(cell, f"parameters of {node.get_fully_qualified_name()}")


def _leaves(record: type[Record], prefix: str = ""):
    for spec in specs(record):
        if issubclass(spec.kind, Record):
            yield from _leaves(spec.kind, f"{prefix}{spec.key}.")
        else:
            yield prefix + spec.key, spec


def _descriptor(spec: Spec, read_only: bool) -> ParameterDescriptor:
    described = f"{spec.text} [{spec.unit}]" if spec.unit else spec.text
    descriptor = ParameterDescriptor(description=described, read_only=read_only, additional_constraints=spec.allowed)
    low, high = max(spec.low, spec.above), spec.high
    if spec.kind is float and (math.isfinite(low) or math.isfinite(high)):
        limits = FloatingPointRange(from_value=max(low, -LARGE), to_value=min(high, LARGE))
        descriptor.floating_point_range = [limits]
    if spec.kind is int and math.isfinite(low) and math.isfinite(high):
        descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high))]
    if spec.kind is np.ndarray:
        descriptor.type = ParameterType.PARAMETER_DOUBLE_ARRAY
    return descriptor
