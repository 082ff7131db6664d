"""What RLlib must be told of a vector environment; it is not imported here."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode


class WorkerStreams:
    """RLlib's ``on_environment_created``: sees to each worker's environments.

    RLlib seeds worker w with seed + w, and a vector environment its sub-environment i with that
    and i more, so that neighbouring workers would share all episodes but one. Give RLlib no seed
    (``debugging(seed=None)``) and this one.

    Args:
        seed: from which every sub-environment of every worker gets a stream of its own.
    """

    def __init__(self, seed: int) -> None:
        self.seed = seed

    def __call__(self, *, env_runner: Any, env: Any, **told: Any) -> None:
        """Seed the environments of a worker that has just made them.

        Raises:
            ValueError: if RLlib has a seed, which would take the place of these, or the
                environment does not reset as RLlib expects it to: the last step of an episode
                would then stand before the first of the next.
        """
        if env.metadata["autoreset_mode"] != AutoresetMode.NEXT_STEP:
            raise ValueError("RLlib needs autoreset_mode='next_step': leave it at that.")
        if env_runner.config.seed is not None:
            raise ValueError("RLlib's seed gives workers the same episodes: debugging(seed=None).")
        worker = env_runner.worker_index or 0
        stream = np.random.SeedSequence(self.seed, spawn_key=(worker,))
        env.reset(seed=[int(number) for number in stream.generate_state(env.num_envs)])
