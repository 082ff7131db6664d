"""A vector of eight float64 for compiled code: eight filters advance in one instruction.

Numba knows scalars only and leaves vector code to the compiler's guesses. This type
says it outright: an expression written for a float works on eight at once, one per
lane, and no lane sees another. Rows of lanes lie in an array (K, 8), or (K, 1) where one
filter is alone: it gets a vector of one, since a float would invite the compiler's guesses.
"""

from __future__ import annotations

import math
import operator
from functools import lru_cache
from itertools import product

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.datamodel import PrimitiveModel
from numba.core.imputils import lower_builtin
from numba.core.typing.templates import AbstractTemplate, infer_global
from numba.core.typing.templates import signature as typing_signature
from numba.extending import intrinsic, overload, register_model

LANES = 8
# A zero's sign counts: a sum that begins with zero is then rounded in one order alone, in however
# many lanes, and wherever the compiler unrolls its loop
_FLAGS = ("contract", "arcp")
_INLINE = {"forceinline": True}


class LanesType(types.Type):
    """Numba's name for the vector of so many lanes."""

    def __init__(self, lanes: int) -> None:
        super().__init__(name=f"float64x{lanes}")
        self.lanes = lanes

    @property
    def vector(self) -> ir.VectorType:
        """The compiler's name for it."""
        return ir.VectorType(ir.DoubleType(), self.lanes)


@register_model(LanesType)
class _LanesModel(PrimitiveModel):
    def __init__(self, manager, frontend_type) -> None:
        super().__init__(manager, frontend_type, frontend_type.vector)


class RowsType(types.Type):
    """Numba's name for the place of rows of so many lanes: unlike an array one number, which
    nobody counts references of, so that functions which are handed many compile fast."""

    def __init__(self, lanes: int) -> None:
        super().__init__(name=f"rows{lanes}")
        self.lanes = lanes


@register_model(RowsType)
class _RowsModel(PrimitiveModel):
    def __init__(self, manager, frontend_type) -> None:
        vector = LanesType(frontend_type.lanes).vector
        super().__init__(manager, frontend_type, vector.as_pointer())


@lru_cache
def rows_of(lanes: int):
    """What finds the rows from one on in a contiguous float64 array (K, lanes)."""

    @intrinsic
    def found(context, array, first):

        def generate(context, builder, signature, arguments):
            data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
            pointer = context.get_value_type(signature.return_type)
            return builder.gep(builder.bitcast(data, pointer), [arguments[1]])

        return RowsType(lanes)(array, types.intp), generate

    return found


@intrinsic
def lanes_of(context, rows):
    """How many lanes the rows have: a constant of compiled code."""

    def generate(context, builder, signature, arguments):
        return context.get_constant(types.intp, signature.args[0].lanes)

    return types.intp(rows), generate


def _entry(builder, rows, arguments):
    """The address of an entry in a row's lane."""
    flat = builder.bitcast(arguments[0], ir.DoubleType().as_pointer())
    place = builder.mul(arguments[1], arguments[1].type(rows.lanes))
    return builder.gep(flat, [builder.add(place, arguments[2])])


@intrinsic
def peek(context, rows, index, lane):
    """One lane of row `index`."""

    def generate(context, builder, signature, arguments):
        return builder.load(_entry(builder, signature.args[0], arguments))

    return types.float64(rows, types.intp, types.intp), generate


@intrinsic
def poke(context, rows, index, lane, value):
    """Write one lane of row `index`."""

    def generate(context, builder, signature, arguments):
        builder.store(arguments[3], _entry(builder, signature.args[0], arguments))
        return context.get_dummy_value()

    return types.void(rows, types.intp, types.intp, types.float64), generate


@lru_cache
def spread_over(lanes: int):
    """What puts the same float in so many lanes."""

    @intrinsic
    def spread(context, number):
        def generate(context, builder, signature, arguments):
            return _spread(builder, arguments[0], lanes)

        return LanesType(lanes)(types.float64), generate

    return spread


spread = spread_over(LANES)


def _row(kind) -> LanesType:
    return LanesType(kind.lanes if isinstance(kind, RowsType) else LANES)


def _address(context, builder, signature, arguments):
    if isinstance(signature.args[0], RowsType):
        return builder.gep(arguments[0], [arguments[1]])
    array = context.make_array(signature.args[0])(context, builder, arguments[0])
    base = builder.bitcast(array.data, LanesType(LANES).vector.as_pointer())
    return builder.gep(base, [arguments[1]])


@intrinsic
def load(context, array, index):
    """Row `index` of rows, or of a contiguous float64 array (K, 8)."""

    def generate(context, builder, signature, arguments):
        return builder.load(_address(context, builder, signature, arguments), align=8)

    return _row(array)(array, types.intp), generate


@intrinsic
def store(context, array, index, value):
    """Write row `index` of rows, or of a contiguous float64 array (K, 8)."""

    def generate(context, builder, signature, arguments):
        address = _address(context, builder, signature, arguments)
        builder.store(arguments[2], address, align=8)
        return context.get_dummy_value()

    return types.void(array, types.intp, _row(array)), generate


def _is_lanes(*kinds) -> bool:
    return any(isinstance(kind, LanesType) for kind in kinds)


def _is_number(kind) -> bool:
    return isinstance(kind, types.Float | types.Integer)


def _teach(symbol, arity: int, build) -> None:
    """Let an operator or function take lanes and numbers in any order, at least one of them lanes.

    Numba compiles every overload as a function, which takes time; this is one instruction.
    """

    class Lanewise(AbstractTemplate):
        key = symbol

        def generic(self, kinds, keywords):
            if len(kinds) != arity or not _is_lanes(*kinds):
                return None
            if not all(_is_lanes(kind) or _is_number(kind) for kind in kinds):
                return None
            lanes = next(kind for kind in kinds if _is_lanes(kind))
            given = (lanes if _is_lanes(kind) else types.float64 for kind in kinds)
            return typing_signature(lanes, *given)

    infer_global(symbol)(Lanewise)

    def generate(context, builder, signature, arguments):
        vectors = (
            value if _is_lanes(kind) else _spread(builder, value, signature.return_type.lanes)
            for kind, value in zip(signature.args, arguments, strict=True)
        )
        return build(builder, *vectors)

    for kinds in product((LanesType, types.Float), repeat=arity):
        if LanesType in kinds:
            lower_builtin(symbol, *kinds)(generate)


def _spread(builder, number, lanes):
    undefined = ir.Constant(LanesType(lanes).vector, ir.Undefined)
    first = ir.Constant(ir.IntType(32), 0)
    vector = builder.insert_element(undefined, number, first)
    places = ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes)
    return builder.shuffle_vector(vector, undefined, places)


def _instruction(name: str):
    return lambda builder, a, b: getattr(builder, name)(a, b, flags=_FLAGS)


def _intrinsic(name: str):
    def call(builder, *vectors):
        vector = vectors[0].type
        kind = ir.FunctionType(vector, [vector] * len(vectors))
        full_name = f"llvm.{name}.v{vector.count}f64"
        function = cgutils.get_or_insert_function(builder.module, kind, full_name)
        return builder.call(function, vectors)

    return call


_teach(operator.add, 2, _instruction("fadd"))
_teach(operator.sub, 2, _instruction("fsub"))
_teach(operator.mul, 2, _instruction("fmul"))
_teach(operator.truediv, 2, _instruction("fdiv"))
_teach(operator.neg, 1, lambda builder, a: builder.fneg(a))
_teach(abs, 1, _intrinsic("fabs"))


@intrinsic
def _one(context, a):
    """One in as many lanes as a has."""

    def generate(context, builder, signature, arguments):
        return _spread(builder, ir.Constant(ir.DoubleType(), 1.0), signature.return_type.lanes)

    return a(a), generate


@overload(operator.pow, jit_options=_INLINE)
def _overload_pow(a, b):
    """Whole exponents alone."""
    if not (_is_lanes(a) and isinstance(b, types.Integer)):
        return None

    def power(a, b):
        result = _one(a)
        for _ in range(abs(b)):
            result = result * a
        return result if b >= 0 else 1.0 / result

    return power


@lru_cache
def lift_to(lanes: int):
    """What puts a number in so many lanes, and leaves lanes as they are."""
    kind = LanesType(lanes)

    @intrinsic
    def lift(context, a):
        def generate(context, builder, signature, arguments):
            return arguments[0] if _is_lanes(a) else _spread(builder, arguments[0], lanes)

        return kind(a if _is_lanes(a) else types.float64), generate

    return lift


def where_greater(a, b, x, y):
    """x where a > b, otherwise (NaN included) y; lane by lane, without a branch."""
    return x if a > b else y


_teach(
    where_greater, 4,
    lambda builder, a, b, x, y: builder.select(builder.fcmp_ordered(">", a, b), x, y),
)  # fmt: skip


@overload(where_greater, jit_options=_INLINE)
def _overload_where_greater(a, b, x, y):
    return None if _is_lanes(a, b, x, y) else (lambda a, b, x, y: x if a > b else y)


def sqrt(a):
    """Square root."""
    return math.sqrt(a)


_teach(sqrt, 1, _intrinsic("sqrt"))


@overload(sqrt, jit_options=_INLINE)
def _overload_sqrt(a):
    return None if _is_lanes(a) else (lambda a: math.sqrt(a))


def exp(a):
    """Exponential."""
    return math.exp(a)


_teach(exp, 1, _intrinsic("exp"))  # lane by lane


@overload(exp, jit_options=_INLINE)
def _overload_exp(a):
    return None if _is_lanes(a) else (lambda a: math.exp(a))


def log(a):
    """Natural logarithm."""
    return math.log(a)


_teach(log, 1, _intrinsic("log"))  # lane by lane


@overload(log, jit_options=_INLINE)
def _overload_log(a):
    return None if _is_lanes(a) else (lambda a: math.log(a))


def floor(a):
    """Largest whole number not above a, as a float."""
    return float(math.floor(a))


_teach(floor, 1, _intrinsic("floor"))


@overload(floor, jit_options=_INLINE)
def _overload_floor(a):
    return None if _is_lanes(a) else (lambda a: float(math.floor(a)))


def copysign(a, b):
    """|a| with the sign of b."""
    return math.copysign(a, b)


_teach(copysign, 2, _intrinsic("copysign"))


@overload(copysign, jit_options=_INLINE)
def _overload_copysign(a, b):
    return None if _is_lanes(a, b) else (lambda a, b: math.copysign(a, b))
