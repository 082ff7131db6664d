"""Every fixed filter as a contestant: told noise, knobs at one."""

from __future__ import annotations

from typing import Any

import numpy as np

from kfenv.envs.options import Options
from kfenv.filters.adaptive import AdaptiveFilter, told_design
from kfenv.filters.designs import DESIGNS
from kfenv.filters.reference import ReferenceFilter
from kfenv.filters.results import History
from kfenv.filters.transforms import StateFunction
from kfenv.models.namespaces import batch, dual
from kfenv.scenarios.recording import Recording

from .agent import RecordingFilter


class FamilyFilter(RecordingFilter):
    """The design of `kfenv.filters.designs.DESIGNS` that has this name.

    Unscented designs take the environment's kappa; the others have none.
    """

    def check(self, scenario: Any, options: Options, recording: Recording) -> None:
        """See `RecordingFilter.check`.

        Raises:
            ValueError: if the design's sigma points do not exist with this kappa, or a
                linear filter meets a model that is not linear.
        """
        self._build(scenario, options)
        if self.name == "lkf" and not _is_linear(scenario, recording):
            raise ValueError(
                f"lkf is for linear models, and {scenario.name} has others: name ekf-classical, "
                "which is the same filter linearised anew at every estimate."
            )

    def filter(self, scenario: Any, options: Options, recording: Recording) -> History:
        """See `RecordingFilter.filter`."""
        return self._build(scenario, options).history(recording)

    def _build(self, scenario: Any, options: Options) -> ReferenceFilter:
        kappa = options.kappa if DESIGNS[self.name].transform == "unscented" else None
        return ReferenceFilter(scenario.motion, scenario.sensor, self.name, kappa)


class AdaptiveFamilyFilter(RecordingFilter):
    """The design of `kfenv.filters.adaptive.ADAPTIVE_DESIGNS` that has this name.

    A Gaussian sum is made for the scenario's mixture where it has one, otherwise for that
    of `kfenv.filters.gaussian_sum.Mixture`.
    """

    def check(self, scenario: Any, options: Options, recording: Recording) -> None:
        """See `RecordingFilter.check`; there is nothing to complain about."""

    def filter(self, scenario: Any, options: Options, recording: Recording) -> History:
        """See `RecordingFilter.filter`."""
        design = told_design(self.name, scenario.mixture)
        tier = AdaptiveFilter(scenario.motion, scenario.sensor, design, compiled=True)
        return tier.history(recording)


def _is_linear(scenario: Any, recording: Recording) -> bool:
    """Whether motion and sensor have the same slopes at the initial mean and a deviation away."""
    states = recording.mean[0] + np.stack([0.0 * recording.mean[0], recording.factor[0].sum(1)])
    no_angles, dt = np.array([], int), np.full(2, recording.times[0, 1] - recording.times[0, 0])
    motion, sensor = scenario.motion.build, scenario.sensor.build
    known = recording.motion_inputs[[0, 0], 1], recording.sensor_inputs[[0, 0], 0]
    functions = (
        StateFunction(motion(batch).step, motion(dual).step, no_angles, known[0], dt),
        StateFunction(sensor(batch), sensor(dual), no_angles, known[1]),
    )
    return all(np.array_equal(*function.jacobian(states)) for function in functions)
