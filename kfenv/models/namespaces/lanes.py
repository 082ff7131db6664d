"""A vector of eight float64 for compiled code: eight filters advance in one instruction.

Numba knows scalars only and leaves vector code to the compiler's guesses. This type
says it outright: an expression written for a float works on eight at once, one per
lane, and no lane sees another.
"""

from __future__ import annotations

import math
import operator
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
_VECTOR = ir.VectorType(ir.DoubleType(), LANES)
_FLAGS = ("contract", "nsz", "arcp")
_INLINE = {"forceinline": True}


class LanesType(types.Type):
    """Numba's name for the vector."""

    def __init__(self) -> None:
        super().__init__(name="float64x8")


lanes_type = LanesType()


@register_model(LanesType)
class _LanesModel(PrimitiveModel):
    def __init__(self, manager, frontend_type) -> None:
        super().__init__(manager, frontend_type, _VECTOR)


@intrinsic
def spread(context, number):
    """The same float in all lanes."""

    def generate(context, builder, signature, arguments):
        return _spread(builder, arguments[0])

    return lanes_type(types.float64), generate


def _address(context, builder, signature, arguments):
    array = context.make_array(signature.args[0])(context, builder, arguments[0])
    base = builder.bitcast(array.data, _VECTOR.as_pointer())
    return builder.gep(base, [arguments[1]])


@intrinsic
def load(context, array, index):
    """Row `index` of a contiguous float64 array (K, 8)."""

    def generate(context, builder, signature, arguments):
        return builder.load(_address(context, builder, signature, arguments), align=8)

    return lanes_type(array, types.intp), generate


@intrinsic
def store(context, array, index, value):
    """Write row `index` of a contiguous float64 array (K, 8)."""

    def generate(context, builder, signature, arguments):
        address = _address(context, builder, signature, arguments)
        builder.store(arguments[2], address, align=8)
        return context.get_dummy_value()

    return types.void(array, types.intp, lanes_type), generate


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
            given = (lanes_type if _is_lanes(kind) else types.float64 for kind in kinds)
            return typing_signature(lanes_type, *given)

    infer_global(symbol)(Lanewise)

    def generate(context, builder, signature, arguments):
        vectors = (
            value if _is_lanes(kind) else _spread(builder, value)
            for kind, value in zip(signature.args, arguments, strict=True)
        )
        return build(builder, *vectors)

    for kinds in product((LanesType, types.Float), repeat=arity):
        if LanesType in kinds:
            lower_builtin(symbol, *kinds)(generate)


def _spread(builder, number):
    undefined = ir.Constant(_VECTOR, ir.Undefined)
    first = ir.Constant(ir.IntType(32), 0)
    vector = builder.insert_element(undefined, number, first)
    places = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(vector, undefined, places)


def _instruction(name: str):
    return lambda builder, a, b: getattr(builder, name)(a, b, flags=_FLAGS)


def _intrinsic(name: str):
    def call(builder, *vectors):
        kind = ir.FunctionType(_VECTOR, [_VECTOR] * len(vectors))
        function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v8f64")
        return builder.call(function, vectors)

    return call


_teach(operator.add, 2, _instruction("fadd"))
_teach(operator.sub, 2, _instruction("fsub"))
_teach(operator.mul, 2, _instruction("fmul"))
_teach(operator.truediv, 2, _instruction("fdiv"))
_teach(operator.neg, 1, lambda builder, a: builder.fneg(a))
_teach(abs, 1, _intrinsic("fabs"))


@overload(operator.pow, jit_options=_INLINE)
def _overload_pow(a, b):
    """Whole exponents alone."""
    if not (_is_lanes(a) and isinstance(b, types.Integer)):
        return None

    def power(a, b):
        result = spread(1.0)
        for _ in range(abs(b)):
            result = result * a
        return result if b >= 0 else 1.0 / result

    return power


def lift(a):
    """A number in all lanes; lanes as they are."""
    return a


_teach(lift, 1, lambda builder, a: a)


@overload(lift, jit_options=_INLINE)
def _overload_lift(a):
    return None if _is_lanes(a) else (lambda a: spread(float(a)))


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
