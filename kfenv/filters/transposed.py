"""Arrays that hold one filter after the other, from and to rows of lanes: whole vectors at once.

Entry by entry each vector would have to wait for its eight numbers, which takes as long as a
filter's update.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from kfenv.models.namespaces.lanes import LanesType

_FLOATS = ir.DoubleType().as_pointer()


@intrinsic
def abreast(context, rows, array, first, index):
    """Entry `index` of the array's rows from `first` on, one in each lane that `rows` have.

    The array (B, ...) is float64, what it holds of one filter contiguous; its last row fills up.
    """

    def generate(context, builder, signature, arguments):
        lanes, kind = signature.return_type.lanes, signature.args[1]
        source = context.make_array(kind)(context, builder, arguments[1])
        stride = builder.extract_value(source.strides, 0)
        last = builder.sub(builder.extract_value(source.shape, 0), stride.type(1))
        start = builder.bitcast(source.data, ir.IntType(8).as_pointer())
        vector = ir.Constant(signature.return_type.vector, ir.Undefined)
        for lane in range(lanes):
            row = builder.add(arguments[2], stride.type(lane))
            row = builder.select(builder.icmp_signed("<", row, last), row, last)
            place = builder.gep(start, [builder.mul(row, stride)])
            place = builder.bitcast(place, ir.DoubleType().as_pointer())
            entry = builder.load(builder.gep(place, [arguments[3]]))
            vector = builder.insert_element(vector, entry, ir.Constant(ir.IntType(32), lane))
        return vector

    return LanesType(rows.lanes)(rows, array, types.intp, types.intp), generate


@intrinsic
def row_address(context, array, row):
    """Where an array's row is, see `abreast`, and how many bytes on the next one: two numbers.

    Functions that are handed these are compiled but once, for arrays of whatever kind.
    """

    def generate(context, builder, signature, arguments):
        target = context.make_array(signature.args[0])(context, builder, arguments[0])
        stride = builder.extract_value(target.strides, 0)
        start = builder.ptrtoint(target.data, stride.type)
        first = builder.add(start, builder.mul(arguments[1], stride))
        return context.make_tuple(builder, signature.return_type, (first, stride))

    return types.UniTuple(types.intp, 2)(array, types.intp), generate


@intrinsic
def hand_out(context, rows, index, address, stride, takers):
    """Write as many rows from `index` on as they have lanes: each lane to a row of an array.

    Args:
        address, stride: of the array's row for the first lane, and to the next, in bytes.
        takers: bit l tells whether lane l takes.
    """

    def generate(context, builder, signature, arguments):
        rows, index, address, stride, takers = arguments
        places = (builder.add(index, index.type(row)) for row in range(signature.args[0].lanes))
        taken = [builder.load(builder.gep(rows, [place]), align=8) for place in places]
        for lane, vector in enumerate(_transposed(builder, taken)):
            bit = builder.and_(takers, takers.type(1 << lane))
            with builder.if_then(builder.icmp_signed("!=", bit, bit.type(0))):
                row = builder.add(address, builder.mul(stride, stride.type(lane)))
                place = builder.gep(builder.inttoptr(row, _FLOATS), [index])
                builder.store(vector, builder.bitcast(place, rows.type), align=8)
        return context.get_dummy_value()

    return types.void(rows, *[types.intp] * 4), generate


@intrinsic
def put(context, address, index, value):
    """Write entry `index` of a row."""

    def generate(context, builder, signature, arguments):
        address, index, value = arguments
        builder.store(value, builder.gep(builder.inttoptr(address, _FLOATS), [index]))
        return context.get_dummy_value()

    return types.void(types.intp, types.intp, types.float64), generate


def _transposed(builder, vectors):
    """Of as many vectors as they have lanes: entry j of number i becomes entry i of number j."""
    size, width = len(vectors), 1
    while width < size:
        # Of a pair's entries, numbered through: those at places without the bit, and the others
        first = [j + size - width if j & width else j for j in range(size)]
        kind = ir.VectorType(ir.IntType(32), size)
        low, high = (ir.Constant(kind, [j + shift for j in first]) for shift in (0, width))
        for i in (i for i in range(size) if not i & width):
            pair = vectors[i], vectors[i + width]
            vectors[i] = builder.shuffle_vector(*pair, low)
            vectors[i + width] = builder.shuffle_vector(*pair, high)
        width *= 2
    return vectors
