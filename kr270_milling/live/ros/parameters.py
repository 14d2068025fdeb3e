"""Declare the parameter records as ROS parameters with descriptor and range, and build the records from them."""

from __future__ import annotations

import array
import dataclasses
import math

import numpy as np
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, ParameterType
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterUninitializedException,
)
from rclpy.parameter import Parameter

from kr270_milling.base.errors import ConfigError
from kr270_milling.base.parameter_file import find_file, merge, read_tree
from kr270_milling.base.record import Record, Spec, build, specs
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


def declare(node, record: type[Record], writable: tuple[str, ...] = ()):
    """Declare every parameter of a record class on a node and return the record.

    Values come from the node's parameter file; where that is silent, from the files named in ``includes``, then from
    the record's defaults. All are read-only but those named in ``writable``. Raises ConfigError with node, key, value
    and allowed range.
    """
    source = f"parameters of {node.get_fully_qualified_name()}"
    about = ParameterDescriptor(description="parameter files that the values not given here come from", read_only=True)
    names = node.declare_parameter("includes", [""], about).value
    below: dict = {}
    for name in filter(None, names):
        below = merge(below, read_tree(find_file(name)))
    tree: dict = {}
    for path, spec in _leaves(record):
        value = _declared(node, path, spec, _lookup(below, path), source, path not in writable)
        if value is not None:
            group = tree
            *parents, key = path.split(".")
            for parent in parents:
                group = group.setdefault(parent, {})
            group[key] = value
    return build(record, tree, source)


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


def _lookup(tree, path: str):
    for part in path.split("."):
        if not isinstance(tree, dict) or part not in tree:
            return None
        tree = tree[part]
    return tree


def _declared(node, path: str, spec: Spec, included, source: str, read_only: bool):
    """The parameter's value in the file's unit, or None where only the record's default is left."""
    default = _whole(spec, included) if included is not None else _default(spec)
    given = TYPES[spec.kind] if default is None else default
    try:
        value = _value(node, path, given, spec, _descriptor(spec, read_only), source)
    except ParameterUninitializedException:
        raise ConfigError(source, path, None, f"is missing; it must be {spec.allowed} ({spec.text})") from None
    except (InvalidParameterTypeException, InvalidParameterValueException) as error:
        shown = getattr(getattr(error, "parameter", None), "value", getattr(error, "value", "?"))
        raise ConfigError(source, path, shown, spec.allowed) from None
    if spec.default is not dataclasses.MISSING and (value is None or (included is None and _same(value, default))):
        return None  # the record's own default, which is in SI already
    if value is None:
        raise ConfigError(source, path, None, f"is missing; it must be {spec.allowed} ({spec.text})")
    if isinstance(value, (array.array, np.ndarray)):
        return [float(v) for v in value]
    return list(value) if isinstance(value, (tuple, list)) else value


def _same(value, default) -> bool:
    return default is not None and np.array_equal(value, default)


def _value(node, path: str, given, spec: Spec, descriptor: ParameterDescriptor, source: str):
    """Return the value of a declared parameter; a whole number in the node's file is read as a float."""
    try:
        return node.declare_parameter(path, given, descriptor).value
    except InvalidParameterTypeException:
        given_value = node.declare_parameter(path, None, ParameterDescriptor(dynamic_typing=True)).value
        node.undeclare_parameter(path)
        value = _whole(spec, given_value)
        if value is given_value:
            raise ConfigError(source, path, given_value, spec.allowed) from None
        return node.declare_parameter(path, value, descriptor, ignore_override=True).value


def _whole(spec: Spec, value):
    """Convert whole numbers to floats where the record has floats; YAML writes 1 for 1.0."""
    if spec.kind is float and type(value) is int:
        return float(value)
    numbers = isinstance(value, (list, array.array)) and all(type(v) in (int, float) for v in value)
    if spec.kind is np.ndarray and numbers and any(type(v) is int for v in value):
        return array.array("d", map(float, value))
    return value


def _default(spec: Spec):
    if spec.default is dataclasses.MISSING or spec.optional or np.size(spec.default) == 0:
        return None  # no default, or an empty list, whose type ROS cannot derive
    if spec.kind is np.ndarray:
        return array.array("d", spec.default / spec.scale)
    return spec.default / spec.scale if spec.kind is float else spec.default


def _descriptor(spec: Spec, read_only: bool) -> ParameterDescriptor:
    described = f"{spec.text} [{spec.unit}]" if spec.unit else spec.text
    descriptor = ParameterDescriptor(description=described, read_only=read_only, additional_constraints=spec.allowed)
    low = max(spec.low, spec.above)
    if spec.kind is float and (math.isfinite(low) or math.isfinite(spec.high)):
        large = 1e300  # the range message has no infinity that every tool reads
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=max(low, -large), to_value=min(spec.high, large))
        ]
    if spec.kind is int and math.isfinite(low) and math.isfinite(spec.high):
        descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(spec.high))]
    if spec.kind is np.ndarray:
        descriptor.type = ParameterType.PARAMETER_DOUBLE_ARRAY
    return descriptor
