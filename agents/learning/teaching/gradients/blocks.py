"""Between a batch of filters and the blocks of `sweep`."""

from math import isnan

from numba import njit

from kfenv.filters.batch_and_lanes import LARGEST
from kfenv.kernel_cache import INNER_KERNEL
from kfenv.models.namespaces.lanes import LANES


@njit(**INNER_KERNEL)
def gather(source, first, w, row):
    """Lane l of the rows from `row` on takes line first + l of the source; the last fills up."""
    last = source.shape[0] - 1
    for lane in range(LANES):
        for k in range(source.shape[1]):
            w[row + k, lane] = source[min(first + lane, last), k]


@njit(**INNER_KERNEL)
def add(source, first, w, row):
    """The same, added; nothing fills up."""
    for lane in range(min(LANES, source.shape[0] - first)):
        for k in range(source.shape[1]):
            w[row + k, lane] += source[first + lane, k]


@njit(**INNER_KERNEL)
def scatter(w, row, first, target):
    """The way back."""
    for lane in range(min(LANES, target.shape[0] - first)):
        for k in range(target.shape[1]):
            target[first + lane, k] = w[row + k, lane]


@njit(**INNER_KERNEL)
def hear(at, w):
    """Mark which channels arrived; return how many any lane heard, which `order` then names."""
    heard = 0
    for c in range(at.m):
        anyone = False
        for lane in range(LANES):
            here = not isnan(w[at.innovation + c, lane])
            anyone |= here
            w[at.here + c, lane] = 1.0 if here else 0.0
            w[at.of_told + c, lane] = 0.0
            if not here:
                w[at.innovation + c, lane] = 0.0
                w[at.told + c, lane] = 1.0
        if anyone:
            w[at.order + heard, 0] = c
            heard += 1
    return heard


@njit(**INNER_KERNEL)
def cut(at, w, lane, is_sound):
    """No slope goes on through a filter that has failed, or that is no number."""
    total = 0.0
    for k in range(at.of_mean, at.end):
        total += abs(w[k, lane])
    if not is_sound or not total <= LARGEST:
        for k in range(at.of_mean, at.end):
            w[k, lane] = 0.0
