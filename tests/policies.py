"""Random policies of log factors, for tests."""

import numpy as np
from kfenv.agents.contest.rollout import scenario_and_options
from kfenv.agents.contestants.policy import NumpyPolicy, write_policy

from kfenv.envs.core import Core

RADAR = "kfenv/RadarTracking-v0"


def random_arrays(kind, features=9, knobs=3, hidden=12, seed=0):
    """Weights large enough to saturate here and there."""
    rng = np.random.default_rng(seed)
    recurrent = kind == "gru"
    beside = 2 * hidden if recurrent else hidden
    shapes = {
        "mean": features, "weight_in": (features, hidden), "bias_in": hidden,
        "weight_mid": (beside, hidden), "bias_mid": hidden,
        "weight_out": (hidden, knobs), "bias_out": knobs,
    }  # fmt: skip
    if recurrent:
        shapes |= {"weight_ih": (hidden, 3 * hidden), "weight_hh": (hidden, 3 * hidden)}
        shapes |= {"bias_ih": 3 * hidden, "bias_hh": 3 * hidden}
    arrays = {n: 0.5 * rng.standard_normal(s).astype(np.float32) for n, s in shapes.items()}
    arrays["deviation"] = rng.uniform(0.5, 2.0, features).astype(np.float32)
    arrays["log_low"] = np.full(knobs, -1.0, np.float32)
    arrays["log_high"] = np.full(knobs, 1.5, np.float32)
    return {"kind": kind, **arrays}


def about(features=9, knobs=3, **changes):
    """What such a policy was trained on: nothing that is."""
    return {
        "env_id": "Nowhere-v0",
        "env_kwargs": {"rate": 2},
        "features": [f"feature {i}" for i in range(features)],
        "knobs": [(f"knob {i}", 0.01, 100.0 * (i + 1)) for i in range(knobs)],
        "metadata": {"note": "a test"},
    } | changes


def random_policy(path, kind="gru"):
    return NumpyPolicy.load(write_policy(path, random_arrays(kind), about()))


def trained_on(path, env_id, kind="gru", **env_kwargs):
    """An untrained policy that fits an environment."""
    scenario, options = scenario_and_options(env_id, env_kwargs)
    core = Core(scenario, options, 1, scenario.time, has_truth=True)
    arrays = random_arrays(kind, core.observation_size, len(core.knobs))
    told = {"env_id": env_id, "env_kwargs": env_kwargs}
    told |= {"features": core.feature_names(), "knobs": core.knobs}
    return write_policy(path, arrays, told)
