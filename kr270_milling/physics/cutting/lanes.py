"""Sixteen nodes at once: the innermost step of the sweep, as vector instructions, or as a plain loop.

A tooth meets some ten nodes of a column. A loop over so few costs more in its beginning and end than in the nodes, and
the compiler cannot know that grid and log do not overlap; so this one step is written for the processor. The vector
instructions name the type that a pointer points to at each use, so they serve typed and opaque LLVM pointers. Where a
version of llvmlite cannot build them (it lacks these arguments before 0.44), the plain loop does the same, more slowly.
"""

from collections.abc import Callable

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from kr270_milling.base.compiled import compiled

LANES = 16  #: nodes; grid and log reach that far beyond their last one
NODE, INDEX = ir.IntType(16), ir.IntType(32)
NODES = ir.VectorType(NODE, LANES)


def build_lanes(builder: ir.IRBuilder, pool, start, log, place, count, level) -> None:
    """Write the instructions; pool and log point to nodes (typed or opaque), the others are values."""

    def nodes_at(data, first):
        return builder.bitcast(builder.gep(data, [first], source_etype=NODE), NODES.as_pointer())

    def in_all_lanes(value):
        lane = builder.insert_element(ir.Constant(NODES, ir.Undefined), value, INDEX(0))
        return builder.shuffle_vector(lane, lane, ir.Constant(ir.VectorType(INDEX, LANES), [0] * LANES))

    here = nodes_at(pool, start)
    before = builder.load(here, align=2, typ=NODES)
    builder.store(before, nodes_at(log, place), align=2)
    counted = builder.icmp_unsigned("<", ir.Constant(NODES, list(range(LANES))), in_all_lanes(count))
    least = builder.select(counted, in_all_lanes(level), ir.Constant(NODES, [0] * LANES))
    builder.store(builder.select(builder.icmp_unsigned(">", before, least), before, least), here, align=2)


def _lower_lanes(typing_context, pool, start, log, place, count, level):
    """Lower the first ``count`` of the LANES nodes pool[start:] to ``level``; log[place:] gets what all LANES were.

    pool, log: uint16 arrays; start, place: uint64; count, level: uint16.
    """

    def codegen(context, builder, signature, arguments):
        pool, start, log, place, count, level = arguments
        grid, old = (context.make_array(signature.args[k])(context, builder, arguments[k]).data for k in (0, 2))
        build_lanes(builder, grid, start, old, place, count, level)
        return context.get_dummy_value()

    return types.void(pool, types.uint64, log, types.uint64, types.uint16, types.uint16), codegen


@compiled
def lower_one_by_one(pool, start, log, place, count, level):
    """The same as ``_lower_lanes`` in a plain loop, of the counted nodes alone."""
    for n in range(count):
        before = pool[start + n]
        log[place + n] = before
        pool[start + n] = max(before, level)


def lowering(build: Callable) -> Callable:
    """The intrinsic where ``build`` can write its instructions with the installed llvmlite, else the plain loop."""
    wide = ir.IntType(64)
    function = ir.FunctionType(ir.VoidType(), [NODE.as_pointer(), wide, NODE.as_pointer(), wide, NODE, NODE])
    builder = ir.IRBuilder(ir.Function(ir.Module(), function, "trial").append_basic_block())
    try:
        build(builder, *builder.function.args)
    except (AttributeError, TypeError):
        return lower_one_by_one
    return intrinsic(_lower_lanes)


lower_lanes: Callable = lowering(build_lanes)
