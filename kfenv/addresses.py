"""Arrays that a kernel works on call after call, handed over by their addresses.

To hand over an array takes a tenth of a microsecond, more than most kernels of a single
environment do with it. Where the same twenty arrays are meant every time, they are written down
once, in a table that the kernel reads::

    @njit
    def shrink(table, factor):
        mean, status = arrays_at(table, "ff i")
        ...

    place = Addresses(mean, status)
    shrink(place.table, 0.5)
"""

from __future__ import annotations

from functools import cached_property
from zlib import crc32

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array
from numpy.typing import NDArray

KINDS = np.dtype(np.float64), np.dtype(np.int64), np.dtype(bool)
ELEMENTS = {"f": types.float64, "i": types.int64, "b": types.boolean}
LETTERS = {element: letter for letter, element in ELEMENTS.items()}


class Addresses:
    """Keeps arrays, and tells kernels where they are; a copy or a pickle keeps its own.

    Args:
        *arrays: float64, int64 or bool, in C's order. What they hold may change, they may not.

    Raises:
        ValueError: if one of them is something else, or read-only.
    """

    def __init__(self, *arrays: NDArray) -> None:
        if not all(array.flags.carray and array.dtype in KINDS for array in arrays):
            raise ValueError(
                "A kernel takes writable arrays in C's order alone, of float64, int64 or bool."
            )
        self._arrays = arrays

    def __reduce__(self):
        return Addresses, self._arrays

    @cached_property
    def table(self) -> NDArray[np.int64]:
        """A number of their kinds, then the address and the shape of each."""
        numbers = [_number(" ".join(array.dtype.kind * array.ndim for array in self._arrays))]
        for array in self._arrays:
            numbers += [array.ctypes.data, *array.shape]
        return np.array(numbers, np.int64)


def _number(kinds: str) -> int:
    return crc32(kinds.encode())


@intrinsic
def note_addresses(context, table, arrays):
    """Write the table of an `Addresses` of a tuple of arrays: the faster way for use but once.

    They have to outlive the table's use.
    """
    if not all(kind.layout == "C" and kind.mutable for kind in arrays):
        raise TypingError("A kernel takes writable arrays in C's order alone.")
    kinds = " ".join(LETTERS[kind.dtype] * kind.ndim for kind in arrays)

    def generate(context, builder, signature, arguments):
        numbers = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        whole = numbers.type.pointee
        written = [whole(_number(kinds))]
        for i, kind in enumerate(arrays):
            value = builder.extract_value(arguments[1], i)
            array = context.make_array(kind)(context, builder, value)
            written.append(builder.ptrtoint(array.data, whole))
            written += cgutils.unpack_tuple(builder, array.shape, kind.ndim)
        for i, number in enumerate(written):
            builder.store(number, builder.gep(numbers, [whole(i)]))
        return context.get_dummy_value()

    return types.void(table, arrays), generate


@intrinsic(prefer_literal=True)
def arrays_at(context, table, kinds):
    """The arrays of a table of `Addresses`, in compiled code; nobody counts references to them.

    Args:
        kinds: of each array a letter for each dimension: f for floats, i for whole numbers, b
            for truth values. TypeError if the table is of others.
    """
    named = kinds.literal_value.split()
    found = [types.Array(ELEMENTS[kind[0]], len(kind), "C") for kind in named]

    def generate(context, builder, signature, arguments):
        numbers = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        whole = numbers.type.pointee
        read = (builder.load(builder.gep(numbers, [whole(i)])) for i in range(10**6))
        other = builder.icmp_signed("!=", next(read), whole(_number(" ".join(named))))
        with builder.if_then(other, likely=False):
            told = ("A kernel was handed the addresses of other arrays.",)
            context.call_conv.return_user_exc(builder, TypeError, told)
        arrays = [_array(context, builder, kind, read) for kind in signature.return_type]
        return context.make_tuple(builder, signature.return_type, arrays)

    return types.Tuple(found)(table, kinds), generate


def _array(context, builder, kind, read) -> ir.Value:
    """One of them, from the numbers that are read next."""
    array = context.make_array(kind)(context, builder)
    address = next(read)
    shape = [next(read) for _ in range(kind.ndim)]
    size = address.type(context.get_abi_sizeof(context.get_data_type(kind.dtype)))
    strides = [size]
    for length in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], length))
    populate_array(
        array, data=builder.inttoptr(address, array.data.type), itemsize=size, meminfo=None,
        shape=cgutils.pack_array(builder, shape), strides=cgutils.pack_array(builder, strides),
    )  # fmt: skip
    return array._getvalue()
