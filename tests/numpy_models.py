"""Models of NumPy functions that the tests of a user's own models share."""

import numpy as np
import pendulum

from kfenv.models.own import own_motion, own_sensor

DT = 0.1
SWING = {"R": (0.01,), "mean": (1.0, 0.0), "P": (0.1, 0.1), "duration": 4.0, "rate": 20.0}


def swing(x, u, dt):
    faster = x[1] - 9.81 * dt * np.sin(x[0])
    return np.array([x[0] + dt * faster, faster])


def numpy_pendulum():
    motion = own_motion((pendulum.ANGLE, pendulum.RATE), swing, Q=(0.0, 1e-3))
    return motion, own_sensor((pendulum.ANGLE,), lambda x, s: x[:1], states=2)


def linear(n, m, seed=0):
    """A stable linear model of n states and m channels, its Q and R, as matrices."""
    rng = np.random.default_rng(seed)
    F = 0.95 * np.linalg.qr(rng.normal(size=(n, n)))[0]
    H = rng.normal(size=(m, n))
    half = rng.normal(size=(n, n))
    return F, H, 0.1 * half @ half.T / n, rng.uniform(0.2, 2.0, m) ** 2


def linear_models(F, H, Q):
    motion = own_motion([f"x{i}" for i in range(len(F))], lambda x, u, dt: F @ x, Q)
    return motion, own_sensor([f"z{i}" for i in range(len(H))], lambda x, s: H @ x, len(F))
