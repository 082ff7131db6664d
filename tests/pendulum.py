"""A model of one's own, from nothing to a first result: a pendulum whose angle is measured.

Held as it stands by tests/test_own_models.py: it must stay under 60 lines of code.
"""

import gymnasium as gym
import numpy as np
from kfenv.agents.contest.rollout import rollout
from kfenv.agents.contestants.registry import make_agent

from kfenv.models.model import Component
from kfenv.models.own import own_motion, own_sensor
from kfenv.scenarios.own import simulate

DT, GRAVITY, LENGTH = 0.05, 9.81, 1.0
ANGLE, RATE = Component("angle", "rad", angle=True), Component("rate", "rad/s")


def swing(xp):
    @xp.function
    def step(x, u, dt):
        angle, rate = x
        faster = rate - dt * GRAVITY / LENGTH * xp.sin(angle)
        return angle + dt * faster, faster

    return step


def encoder(xp):
    @xp.function
    def measure(x, s):
        return (x[0],)

    return measure


MODEL = {
    "motion": own_motion((ANGLE, RATE), swing, Q=(0.0, 1e-3)),
    "sensor": own_sensor((ANGLE,), encoder, states=2),
    "scored": ("angle",),
    "scale": 0.05,
    "scored_rates": ("rate",),
}
WORLD = {"R": (0.1**2,), "mean": (1.0, 0.0), "P": (0.1, 0.1), "duration": 10.0, "rate": 1.0 / DT}


def contest(agents, episodes, **keywords):
    """RMSE of each agent, geometric mean over simulated episodes with random faults, rad."""
    recording = simulate(MODEL["motion"], MODEL["sensor"], episodes=episodes, **WORLD)
    place = "kfenv/Filter-v0", MODEL | WORLD | keywords
    scores = {name: rollout(make_agent(name), *place, recording) for name in agents}
    return {name: float(np.exp(np.mean(np.log(told.rmse)))) for name, told in scores.items()}


if __name__ == "__main__":
    env = gym.make("kfenv/Filter-v0", **MODEL, **WORLD)
    print(env.reset(seed=0))
    print(contest(("fixed", "huber-gate", "hmm-noise"), 50))
