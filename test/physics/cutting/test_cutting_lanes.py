"""The innermost step of the sweep: vector instructions with typed and opaque pointers, and the plain loop."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest
from llvmlite import binding, ir
from numba import njit

from kr270_milling.physics.cutting import lanes
from kr270_milling.physics.cutting.lanes import LANES, NODE, build_lanes, lower_lanes, lower_one_by_one


def lowered(lower, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Pool and log after 16 nodes from number 5 were lowered to level 300; the log from number 2 on."""
    pool = np.random.default_rng(count).integers(0, 600, 40).astype(np.uint16)
    log = np.zeros(40, np.uint16)
    lower(pool, np.uint64(5), log, np.uint64(2), np.uint16(count), np.uint16(300))
    return pool, log


@njit
def by_vectors(pool, start, log, place, count, level):
    lower_lanes(pool, start, log, place, count, level)


@pytest.mark.parametrize("count", [0, 1, 7, LANES])
def test_plain_loop_and_vector_instructions_lower_the_same_nodes(count):
    expected, _ = lowered(lambda *_: None, count)
    before = expected[5 : 5 + count].copy()
    expected[5 : 5 + count] = np.maximum(before, 300)
    for lower in (lower_one_by_one, by_vectors):
        pool, log = lowered(lower, count)
        assert np.array_equal(pool, expected) and np.array_equal(log[2 : 2 + count], before)


def test_an_llvmlite_that_cannot_build_the_instructions_gets_the_plain_loop():
    def build(builder, *values):  # as before 0.44
        builder.load(values[0], no_such_argument=NODE)

    assert lanes.lowering(build) is lower_one_by_one
    assert lanes.lowering(build_lanes) is not lower_one_by_one


def test_the_instructions_are_valid_with_opaque_pointers(monkeypatch):
    """As in an llvmlite without typed pointers: every pointer type of the module is ``ptr``."""
    monkeypatch.setattr(ir.Type, "as_pointer", lambda self, addrspace=0: ir.PointerType())
    pointer, wide = ir.PointerType(), ir.IntType(64)
    module = ir.Module()
    function = ir.Function(module, ir.FunctionType(ir.VoidType(), [pointer, wide, pointer, wide, NODE, NODE]), "lower")
    builder = ir.IRBuilder(function.append_basic_block())
    build_lanes(builder, *function.args)
    builder.ret_void()
    assert "i16*" not in str(module)
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    machine = binding.Target.from_default_triple().create_target_machine()
    engine = binding.create_mcjit_compiler(binding.parse_assembly(str(module)), machine)
    engine.finalize_object()
    kinds = (ctypes.c_void_p, ctypes.c_uint64, ctypes.c_void_p, ctypes.c_uint64, ctypes.c_uint16, ctypes.c_uint16)
    call = ctypes.CFUNCTYPE(None, *kinds)(engine.get_function_address("lower"))
    pool, log = lowered(lambda p, s, g, d, n, v: call(p.ctypes.data, int(s), g.ctypes.data, int(d), int(n), int(v)), 9)
    expected, logged = lowered(by_vectors, 9)
    assert np.array_equal(pool, expected) and np.array_equal(log, logged)
