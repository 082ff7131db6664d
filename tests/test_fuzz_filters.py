"""Filters and environments hold what they promise, whatever valid input they get.

``kfenv fuzz`` tries the same for as long as one likes.
"""

import numpy as np
import pytest
from kfenv.agents.fuzzing.campaign import fuzz
from kfenv.agents.fuzzing.filters import check_factor, check_run
from kfenv.agents.fuzzing.recordings import draw_recording
from kfenv.agents.fuzzing.subject import Wrong
from kfenv.agents.fuzzing.subjects import make_subjects
from numpy.random import default_rng

from kfenv.filters.results import Run

CASES = {"engine": 15, "designs": 50, "banks": 50, "environments": 60}


@pytest.mark.parametrize("name", CASES)
def test_whatever_comes_is_filtered_or_refused(name, tmp_path):
    tallies = fuzz(make_subjects((name,)), 0, tmp_path, cases=CASES[name])
    assert tallies[name].findings == {}
    assert tallies[name].cases == CASES[name] and tallies[name].steps > CASES[name]


def test_a_silent_nan_and_its_like_are_seen():
    _, recording = draw_recording(default_rng(0), 2, 5)
    mean = np.ones((2, 5, recording.mean.shape[1]))
    nis = np.where(np.isfinite(recording.measurement).any(axis=2), 1.0, np.nan)
    sound, whole = np.zeros(2, np.int64), np.full(2, -1)
    check_run(Run(mean, nis, sound, whole), recording)
    for spoil, said in (
        (lambda m, n, s, f: m.__setitem__((1, 3, 0), np.nan), "before any failure"),
        (lambda m, n, s, f: f.__setitem__(0, 2), "do not tell of the same"),
        (lambda m, n, s, f: s.__setitem__(0, 9), "none of those"),
        (lambda m, n, s, f: (s.__setitem__(0, 1), f.__setitem__(0, 2)), "after the failure"),
        (lambda m, n, s, f: n.__setitem__(0, np.where(np.isnan(n[0]), 1.0, np.nan)), "NIS"),
    ):
        told = [array.copy() for array in (mean, nis, sound, whole)]
        spoil(*told)
        with pytest.raises(Wrong, match=said):
            check_run(Run(*told), recording)
    for factor, said in ((np.nan, "not finite"), (-1.0, "negative"), ([[1, 1], [0, 1]], "lower")):
        with pytest.raises(Wrong, match=said):
            check_factor(np.ones((1, 2, 2)) * np.eye(2) * factor
                         if np.isscalar(factor) else np.array([factor], float),
                         np.zeros(1, np.int64), "")  # fmt: skip
