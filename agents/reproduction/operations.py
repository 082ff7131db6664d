"""Operations of one measurement update, counted as they are made, against S0's Table 3."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kfenv.filters.sequential import ScalarUpdate, bierman, carlson, dot

from .claims import Claim, judge

Array = NDArray[np.float64]

STATES, CHANNELS = 9, 3
CLOSE = 0.1  # share of a printed count


def joseph_in_s1(n: int, m: int) -> float:
    """Multiplications of Joseph's form as S1 prints them (SPEC F11)."""
    return (4.0 * n**2 + 5.5 * n) * m


class Operations(NamedTuple):
    """How many of each; divisions and roots are None where Table 3 does not print them."""

    additions: float
    multiplications: float
    divisions: float | None = None
    roots: float | None = None


class Counted:
    """A number that counts the operations made on it; subtractions count as additions."""

    def __init__(self, value: float, made: Counter[str]) -> None:
        self.value, self.made = value, made

    def _result(self, kind: str, value: float) -> Counted:
        self.made[kind] += 1
        return Counted(value, self.made)

    def __add__(self, other: Counted) -> Counted:
        return self._result("additions", self.value + other.value)

    def __sub__(self, other: Counted) -> Counted:
        return self._result("additions", self.value - other.value)

    def __mul__(self, other: Counted) -> Counted:
        return self._result("multiplications", self.value * other.value)

    def __truediv__(self, other: Counted) -> Counted:
        return self._result("divisions", self.value / other.value)

    def __rtruediv__(self, number: float) -> Counted:
        return self._result("divisions", number / self.value)

    def sqrt(self) -> Counted:
        """What `numpy.sqrt` calls."""
        return self._result("roots", self.value**0.5)


def conventional(x: Array, P: Array, h: Array, r: Array, z: Array) -> tuple[Array, Array]:
    """P - K (P h)^T in the lower triangle, the rest being its mirror image."""
    x, P, v, gain = _gain(x, P, h, r, z)
    for i, j in _lower(len(x)):
        P[i, j] = P[j, i] = P[i, j] - gain[i] * v[j]
    return x, P


def joseph(x: Array, P: Array, h: Array, r: Array, z: Array) -> tuple[Array, Array]:
    """(I - K h^T) P (I - K h^T)^T + K r K^T by rank-one products, in the lower triangle."""
    x, P, v, gain = _gain(x, P, h, r, z)
    once = np.array([[P[i, j] - gain[i] * v[j] for j in range(len(x))] for i in range(len(x))])
    w = [dot(row, h) for row in once]
    noisy = [entry * r for entry in gain]
    for i, j in _lower(len(x)):
        P[i, j] = P[j, i] = once[i, j] - w[i] * gain[j] + noisy[i] * gain[j]
    return x, P


def _gain(x: Array, P: Array, h: Array, r: Array, z: Array) -> tuple[Array, Array, list, list]:
    """The corrected state, a copy of P, P h and the gain of one channel."""
    residual = z - dot(h, x)
    v = [dot(row, h) for row in P]
    inverse = 1.0 / (dot(h, v) + r)
    gain = [entry * inverse for entry in v]
    moved = np.array([value + entry * residual for value, entry in zip(x, gain, strict=True)])
    return moved, P.copy(), v, gain


def _lower(n: int) -> Iterable[tuple[int, int]]:
    return ((i, j) for i in range(n) for j in range(i + 1))


def _variances_of_unit_triangular(packed: Array) -> list:
    """Diagonal of L D L^T."""
    return [
        sum((packed[i, k] * packed[i, k] * packed[k, k] for k in range(i)), start=packed[i, i])
        for i in range(len(packed))
    ]


def _variances_of_triangular(factor: Array) -> list:
    """Diagonal of S S^T."""
    return [dot(factor[i, : i + 1], factor[i, : i + 1]) for i in range(len(factor))]


class Algorithm(NamedTuple):
    """A row of Table 3: an update, what brings its factor back to variances, and the formula."""

    update: ScalarUpdate
    variances: Callable[[Array], list] | None
    printed: Callable[[int, int], Operations]  # of n states and m channels


ALGORITHMS: dict[str, Algorithm] = {
    "conventional": Algorithm(
        conventional,
        None,
        lambda n, m: Operations((1.5 * n**2 + 3.5 * n) * m, (1.5 * n**2 + 4.5 * n) * m),
    ),
    "U-D": Algorithm(
        bierman,
        _variances_of_unit_triangular,
        lambda n, m: Operations(
            (1.5 * n**2 + 1.5 * n) * m + 0.5 * n**2 - 0.5 * n,
            (1.5 * n**2 + 5.5 * n) * m + n**2 - n,
        ),
    ),
    "triangular square root": Algorithm(
        carlson,
        _variances_of_triangular,
        lambda n, m: Operations(
            (1.5 * n**2 + 3.5 * n) * m + 0.5 * n**2 + 0.5 * n,
            (2.0 * n**2 + 5.0 * n) * m + 0.5 * n**2 + 0.5 * n,
            2.0 * n * m,
            n * m,
        ),
    ),
    "Joseph": Algorithm(
        joseph,
        None,
        lambda n, m: Operations((4.5 * n**2 + 5.5 * n) * m, (4.0 * n**2 + 7.5 * n) * m),
    ),
}


def operations(algorithm: Algorithm, n: int = STATES, m: int = CHANNELS) -> Operations:
    """Count one measurement update of n states by m channels, and its variances if factorised."""
    made: Counter[str] = Counter()
    rng = np.random.default_rng(0)
    counted = np.frompyfunc(lambda value: Counted(value, made), 1, 1)
    x, matrix = counted(np.zeros(n)), counted(np.tril(rng.uniform(0.1, 0.2, (n, n))) + np.eye(n))
    for _ in range(m):
        h, (r, z) = counted(rng.normal(size=n)), counted(np.array([0.5, 1.0]))
        x, matrix = algorithm.update(x, matrix, h, r, z)
    if algorithm.variances:
        algorithm.variances(matrix)
    return Operations(*(made[kind] for kind in Operations._fields))


def table_3() -> list[Claim]:
    """Whether the printed counts are those that the algorithms make."""
    counts = {
        label: (operations(algorithm), algorithm.printed(STATES, CHANNELS))
        for label, algorithm in ALGORITHMS.items()
    }
    additions = _compared(counts, ("additions",))
    others = _compared(counts, Operations._fields[1:])
    what = f"of a measurement update of {STATES} states by {CHANNELS} channels"
    return [
        Claim(
            "Table 3, products (precision)",
            f"multiplications, divisions and square roots {what}",
            "S0 Table 3",
            "made and printed, one channel at a time, variances included where P is factorised: "
            f"{others[0]}. S1 prints {joseph_in_s1(STATES, CHANNELS):g} multiplications for "
            f"Joseph; within {CLOSE:.0%} counts as the same",
            judge(others[1]),
        ),
        Claim(
            "Table 3, sums (precision)",
            f"additions {what}",
            "S0 Table 3",
            f"made and printed: {additions[0]}. Sums are started here with their first term, "
            "not with zero, and Joseph's triangle is worked out once",
            judge(additions[1]),
        ),
    ]


def _compared(
    counts: dict[str, tuple[Operations, Operations]], kinds: tuple[str, ...]
) -> tuple[str, bool]:
    """Made and printed counts in words, and whether all are close."""
    told, close = [], True
    for label, (found, printed) in counts.items():
        pairs = {kind: (getattr(found, kind), getattr(printed, kind)) for kind in kinds}
        known = {kind: pair for kind, pair in pairs.items() if pair[1] is not None}
        words = ", ".join(f"{made:g} of {said:g} {kind}" for kind, (made, said) in known.items())
        told.append(f"{label} {words}")
        close &= all(abs(made / said - 1.0) < CLOSE for made, said in known.values())
    return "; ".join(told), close
