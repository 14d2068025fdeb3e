"""Sixteen nodes at once: the innermost step of the sweep, as vector instructions.

A tooth meets some ten nodes of a column. A loop over so few costs more in its beginning and end than in the nodes, and
the compiler cannot know that grid and log do not overlap; so this one step is written for the processor.
"""

from collections.abc import Callable

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

__all__ = ["LANES", "lower_lanes"]

LANES = 16  #: nodes; grid and log reach that far beyond their last one
NODE, INDEX = ir.IntType(16), ir.IntType(32)
NODES = ir.VectorType(NODE, LANES)


def _lower_lanes(typing_context, pool, start, log, place, count, level):
    """Lower the first ``count`` of the LANES nodes pool[start:] to ``level``; log[place:] gets what all LANES were.

    pool, log: uint16 arrays; start, place: uint64; count, level: uint16.
    """

    def codegen(context, builder, signature, arguments):
        pool, start, log, place, count, level = arguments

        def nodes_at(kind, array, first):
            data = context.make_array(kind)(context, builder, array).data
            return builder.bitcast(builder.gep(data, [first]), NODES.as_pointer())

        def in_all_lanes(value):
            lane = builder.insert_element(ir.Constant(NODES, ir.Undefined), value, INDEX(0))
            return builder.shuffle_vector(lane, lane, ir.Constant(ir.VectorType(INDEX, LANES), [0] * LANES))

        here = nodes_at(signature.args[0], pool, start)
        before = builder.load(here, align=2)
        builder.store(before, nodes_at(signature.args[2], log, place), align=2)
        counted = builder.icmp_unsigned("<", ir.Constant(NODES, list(range(LANES))), in_all_lanes(count))
        least = builder.select(counted, in_all_lanes(level), ir.Constant(NODES, [0] * LANES))
        builder.store(builder.select(builder.icmp_unsigned(">", before, least), before, least), here, align=2)
        return context.get_dummy_value()

    return types.void(pool, types.uint64, log, types.uint64, types.uint16, types.uint16), codegen


lower_lanes: Callable = intrinsic(_lower_lanes)
