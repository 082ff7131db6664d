"""The trained policies that come with kfenv, one for each environment, under one name."""

from __future__ import annotations

from importlib.resources import as_file, files
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from kfenv.envs.options import Options
from kfenv.scenarios.recording import Recording
from kfenv.scenarios.scenario import TrackingScenario

from .agent import Agent, Array
from .learned import Learned

FOLDER = files(f"{__package__.rpartition('.')[0]}.pretrained")


class Pretrained(Agent):
    """The policy that comes with kfenv for whatever environment it meets.

    Class attributes:
        suffix: of the files' names.
    """

    suffix: ClassVar[str] = ""
    sees = "observation"

    def suited_to(self, scenario: TrackingScenario) -> Learned:
        """The policy for a scenario.

        Raises:
            ValueError: if none comes with kfenv.
        """
        file = FOLDER / f"{scenario.name}{self.suffix}.npz"
        if not file.is_file():
            known = (item.name for item in FOLDER.iterdir() if item.name.endswith(".npz"))
            raise ValueError(
                f"No agent {self.name!r} comes with kfenv for {scenario.name}; there are "
                f"{', '.join(sorted(known))}. Train one with `kfenv train`."
            )
        with as_file(file) as path:
            return Learned(path, self.name)

    def check(self, scenario: Any, options: Options, recording: Recording | None) -> None:
        """See `Contestant.check`: there must be a policy, and it must fit."""
        self.suited_to(scenario).check(scenario, options, recording)

    def act(self, observation: NDArray[np.float32], info: dict[str, Any]) -> Array:
        """Never called: another acts in its place.

        Raises:
            RuntimeError: if it is.
        """
        raise RuntimeError("Take suited_to(scenario), which is the agent that acts.")


class PretrainedSmall(Pretrained):
    """The same distilled into a third of the units."""

    suffix = "-small"
