"""Addresses of arrays: kernels find what is meant, or say that they do not."""

import pickle
from copy import deepcopy

import numpy as np
import pytest

from kfenv.addresses import Addresses
from kfenv.envs import scoring, statistics

COPIES = (deepcopy, lambda held: pickle.loads(pickle.dumps(held)))


def innovations():
    """Two filters' arrays as `statistics.notice` wants them, one channel each, and the status."""
    whitened, since, work = np.array([[3.0], [4.0]]), np.zeros(2), np.array([0, 2])
    status = np.zeros(2, np.int64)
    given = whitened, np.zeros(1, np.int64), np.zeros((2, 1, statistics.COLUMNS)), since, work
    return (*given, status), status


def notice(addresses):
    statistics.notice(addresses.table, np.ones(2), np.array([True, True]))


def test_a_kernel_works_on_the_arrays_themselves():
    arrays, status = innovations()
    notice(Addresses(*arrays))
    assert status.tolist() == [0, 2]
    np.testing.assert_array_equal(arrays[2][:, 0, statistics.LAST], [3.0, 0.0])


@pytest.mark.parametrize("copied", COPIES)
def test_a_copy_has_arrays_of_its_own(copied):
    """A table that was copied as it stands would write into what the original holds."""
    arrays, status = innovations()
    original = Addresses(*arrays)
    assert len(original.table) > len(arrays)
    twin, twin_status = copied((original, status))
    notice(twin)
    assert (status.tolist(), twin_status.tolist()) == ([0, 0], [0, 2])


@pytest.mark.parametrize("few", [(), (0,), (0, 1, 2, 3, 4)])
def test_a_kernel_refuses_other_arrays(few):
    arrays, _ = innovations()
    other = Addresses(*(arrays[i] for i in few))
    with pytest.raises(TypeError, match="the addresses of other arrays"):
        notice(other)
    with pytest.raises(TypeError, match="the addresses of other arrays"):
        scoring.arrive(other.table, 1)


def test_only_arrays_that_a_kernel_can_read_and_write_are_taken():
    read_only = np.zeros(2)
    read_only.flags.writeable = False
    for array in (read_only, np.zeros((2, 3)).T, np.zeros(2, np.float32), np.zeros(2, np.int32)):
        with pytest.raises(ValueError, match="writable arrays in C's order"):
            Addresses(np.zeros(2), array)
