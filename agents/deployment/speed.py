"""How fast a tuned filter takes a measurement."""

from __future__ import annotations

import time

import numpy as np

from kfenv.scenarios.radar.tracking import RadarTracking

from ..bench import ENV_ID, Row
from .tuned_filter import TunedFilter


def step_row() -> Row:
    """The median over a few tracks, with the trained agent that comes with kfenv."""
    scenario, times = RadarTracking(rate=2.0), []
    recording = scenario.sample([np.random.default_rng(0)])
    tuned = TunedFilter(ENV_ID, "learned", rate=2.0)
    for _ in range(4):
        tuned.reset(recording.mean[0], recording.factor[0])
        for z, noise in zip(recording.measurement[0], recording.noise[0], strict=True):
            start = time.perf_counter()
            tuned.step(z, 0.5, noise=noise)
            times.append(time.perf_counter() - start)
    what = "TunedFilter.step with the learned agent, median"
    return Row(what, f"{np.median(times) * 1e6:.0f} us", "", "150 us")
