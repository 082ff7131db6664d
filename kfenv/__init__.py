"""Gymnasium environments in which an agent learns to tune an adaptive Kalman filter.

Importing this package registers the environments that `ENVIRONMENTS` lists.
"""

import gymnasium

__version__ = "0.1.0"

_MODULES = {
    "kfenv/RadarTracking-v0": "kfenv.envs.radar",
    "kfenv/RadarValidation-v0": "kfenv.envs.radar",
    "kfenv/BistaticTracking-v0": "kfenv.envs.bistatic",
    "kfenv/InsGnss-v0": "kfenv.envs.inertial",
    "kfenv/GnssTracking-v0": "kfenv.envs.gnss",
    "kfenv/Filter-v0": "kfenv.envs.own",
}
ENVIRONMENTS = tuple(_MODULES)


def _register() -> None:
    for env_id, module in _MODULES.items():
        name = env_id.removeprefix("kfenv/").removesuffix("-v0")
        gymnasium.register(
            env_id,
            entry_point=f"{module}:{name}Env",
            vector_entry_point=f"{module}:{name}VectorEnv",
        )


_register()
