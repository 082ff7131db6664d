"""A vector of eight float64 for compiled code: eight filters advance in one instruction.

Numba knows scalars only and leaves vector code to the compiler's guesses. This type
says it outright: an expression written for a float works on eight at once, one per
lane, and no lane sees another.
"""

from __future__ import annotations

import math
import operator

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.datamodel import PrimitiveModel
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


def _arithmetic(instruction: str):
    @intrinsic
    def operation(context, a, b):
        def generate(context, builder, signature, arguments):
            return getattr(builder, instruction)(*arguments, flags=_FLAGS)

        return lanes_type(lanes_type, lanes_type), generate

    return operation


def _function(name: str, arity: int):
    def generate(context, builder, signature, arguments):
        kind = ir.FunctionType(_VECTOR, [_VECTOR] * arity)
        function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v8f64")
        return builder.call(function, arguments)

    if arity == 1:
        return intrinsic(lambda context, a: (lanes_type(lanes_type), generate))
    return intrinsic(lambda context, a, b: (lanes_type(lanes_type, lanes_type), generate))


_sqrt, _floor, _fabs = (_function(name, 1) for name in ("sqrt", "floor", "fabs"))
_exp, _log = (_function(name, 1) for name in ("exp", "log"))  # lane by lane
_copysign = _function("copysign", 2)


@intrinsic
def _negative(context, a):
    def generate(context, builder, signature, arguments):
        return builder.fneg(arguments[0])

    return lanes_type(lanes_type), generate


@intrinsic
def spread(context, number):
    """The same float in all lanes."""

    def generate(context, builder, signature, arguments):
        undefined = ir.Constant(_VECTOR, ir.Undefined)
        first = ir.Constant(ir.IntType(32), 0)
        vector = builder.insert_element(undefined, arguments[0], first)
        places = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
        return builder.shuffle_vector(vector, undefined, places)

    return lanes_type(types.float64), generate


@intrinsic
def _select_greater(context, a, b, x, y):
    def generate(context, builder, signature, arguments):
        a, b, x, y = arguments
        return builder.select(builder.fcmp_ordered(">", a, b), x, y)

    return lanes_type(*(lanes_type,) * 4), generate


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


def _teach(symbol, instruction: str) -> None:
    """Let an operator take lanes and numbers in either order."""
    operation = _arithmetic(instruction)

    @overload(symbol, jit_options=_INLINE)
    def implementation(a, b):
        if isinstance(a, LanesType) and isinstance(b, LanesType):
            return lambda a, b: operation(a, b)
        if isinstance(a, LanesType) and _is_number(b):
            return lambda a, b: operation(a, spread(float(b)))
        if isinstance(b, LanesType) and _is_number(a):
            return lambda a, b: operation(spread(float(a)), b)
        return None


_teach(operator.add, "fadd")
_teach(operator.sub, "fsub")
_teach(operator.mul, "fmul")
_teach(operator.truediv, "fdiv")


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


@overload(operator.neg, jit_options=_INLINE)
def _overload_neg(a):
    return (lambda a: _negative(a)) if _is_lanes(a) else None


@overload(abs, jit_options=_INLINE)
def _overload_abs(a):
    return (lambda a: _fabs(a)) if _is_lanes(a) else None


def lift(a):
    """A number in all lanes; lanes as they are."""
    return a


@overload(lift, jit_options=_INLINE)
def _overload_lift(a):
    return (lambda a: a) if _is_lanes(a) else (lambda a: spread(float(a)))


def where_greater(a, b, x, y):
    """x where a > b, otherwise (NaN included) y; lane by lane, without a branch."""
    return x if a > b else y


@overload(where_greater, jit_options=_INLINE)
def _overload_where_greater(a, b, x, y):
    if _is_lanes(a, b, x, y):
        return lambda a, b, x, y: _select_greater(lift(a), lift(b), lift(x), lift(y))
    return lambda a, b, x, y: x if a > b else y


def sqrt(a):
    """Square root."""
    return math.sqrt(a)


@overload(sqrt, jit_options=_INLINE)
def _overload_sqrt(a):
    return (lambda a: _sqrt(a)) if _is_lanes(a) else (lambda a: math.sqrt(a))


def exp(a):
    """Exponential."""
    return math.exp(a)


@overload(exp, jit_options=_INLINE)
def _overload_exp(a):
    return (lambda a: _exp(a)) if _is_lanes(a) else (lambda a: math.exp(a))


def log(a):
    """Natural logarithm."""
    return math.log(a)


@overload(log, jit_options=_INLINE)
def _overload_log(a):
    return (lambda a: _log(a)) if _is_lanes(a) else (lambda a: math.log(a))


def floor(a):
    """Largest whole number not above a, as a float."""
    return float(math.floor(a))


@overload(floor, jit_options=_INLINE)
def _overload_floor(a):
    return (lambda a: _floor(a)) if _is_lanes(a) else (lambda a: float(math.floor(a)))


def copysign(a, b):
    """|a| with the sign of b."""
    return math.copysign(a, b)


@overload(copysign, jit_options=_INLINE)
def _overload_copysign(a, b):
    if _is_lanes(a, b):
        return lambda a, b: _copysign(lift(a), lift(b))
    return lambda a, b: math.copysign(a, b)
