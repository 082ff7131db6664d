"""Innovations of a filter with static noise, of many settings of it at once."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kfenv.envs.loop import make_filter
from kfenv.envs.options import Options
from kfenv.filters.protocol import Knobs, elapsed, measured
from kfenv.filters.results import OK, Prediction, Update
from kfenv.scenarios.recording import Recording

Array = NDArray[np.float64]


class Instant(NamedTuple):
    """One instant of S settings of a filter over B episodes, as the engine tells it.

    Attributes:
        index: of the instant.
        update: its arrays are (S * B, ...), one setting after the other.
        predicted: means (S * B, n) before it.
        sound: (S * B,) whether the filter has not failed.
    """

    index: int
    update: Update
    predicted: Array
    sound: NDArray[np.bool_]


def instants(
    scenario: Any, options: Options, recording: Recording, left: Array, noise: Array
) -> Iterator[Instant]:
    """Filter every episode under every setting, instant by instant.

    Args:
        left: (S, n, n) what each setting makes of the process noise's factor.
        noise: (S, m) what it makes of the told deviations.
    """
    settings, episodes = len(left), len(recording)
    tier = make_filter(scenario, options)
    left, noise = (np.repeat(array, episodes, axis=0) for array in (left, noise))
    mean, factor = (np.concatenate([x] * settings) for x in (recording.mean, recording.factor))
    status, knobs = np.zeros(len(left), np.int64), Knobs.nominal(len(left))
    dt = np.concatenate([elapsed(recording)] * settings)
    for t in range(dt.shape[1]):
        if t == 0:
            prediction = Prediction(mean, factor, np.zeros_like(factor))
        else:
            inputs = np.concatenate([recording.motion_inputs[:, t]] * settings)
            prediction = tier.predict(mean, factor, inputs, dt[:, t].copy(), status)
            prediction = prediction._replace(noise=left @ prediction.noise)
        arrived = measured(recording, t)
        arrived = type(arrived)(*(np.concatenate([array] * settings) for array in arrived))
        told = arrived._replace(noise=arrived.noise * noise)
        update = tier.update(prediction, knobs, told, status)
        mean, factor = update.mean, update.factor
        yield Instant(t, update, prediction.mean, status == OK)
