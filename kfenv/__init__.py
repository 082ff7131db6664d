"""Gymnasium environments in which an agent learns to tune an adaptive Kalman filter.

Importing this package registers the environments ``kfenv/RadarTracking-v0`` and
``kfenv/RadarValidation-v0``.
"""

import gymnasium

__version__ = "0.1.0"

ENVIRONMENTS = ("kfenv/RadarTracking-v0", "kfenv/RadarValidation-v0")


def _register() -> None:
    for env_id in ENVIRONMENTS:
        name = env_id.removeprefix("kfenv/").removesuffix("-v0")
        gymnasium.register(
            env_id,
            entry_point=f"kfenv.envs.radar:{name}Env",
            vector_entry_point=f"kfenv.envs.radar:{name}VectorEnv",
        )


_register()
