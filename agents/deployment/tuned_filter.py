"""The filter with its agent, fed measurement by measurement: what a contest compared, at work."""

from __future__ import annotations

import json
from collections.abc import Mapping
from copy import copy
from dataclasses import replace
from functools import cached_property
from math import isfinite, isinf, nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kfenv.envs.loop import Loop
from kfenv.filters.protocol import Measurement
from kfenv.filters.results import FAILURES
from kfenv.names import unknown

from ..contest.rollout import scenario_and_options
from ..contestants.agent import Agent, Briefing, Contestant
from ..contestants.learned import Learned
from ..contestants.registry import make_agent
from .state import read_state, restore, write_state

Array = NDArray[np.float64]

ONE = np.ones(1, bool)


class Step(NamedTuple):
    """What a step makes of a measurement."""

    time: float  # of the measurement, s
    estimate: Array  # (n,)
    covariance: Array  # (n, n)
    nis: float  # normalised innovation squared, NaN where nothing arrived
    knobs: dict[str, float]  # the factors that the agent set, by name


class TunedFilter:
    """One target's filter whose knobs an agent turns: the loop of an environment, without truth.

    The same measurements give the same bits as the environment stepping a recording of them. ::

        tuned = TunedFilter("kfenv/RadarTracking-v0", "learned", rate=2.0)
        tuned.reset(mean)  # the initial estimate, at the first measurement's time
        for z, noise in measurements:  # every 0.5 s, NaN where a channel is missing
            estimate = tuned.step(z, 0.5, noise=noise).estimate

    Args:
        env_id: of an environment of kfenv, whose models and scales serve: ``"kfenv/Filter-v0"``
            with ``motion`` and ``sensor`` for models of one's own.
        agent: ``"learned"``, the path of a policy, the name of a rule, or an `Agent`.
        values: tuned parameters of a rule, by name; its defaults where left out.
        nominal_noise: (m,) deviations of the measurements where `step` is told none; by default
            those of the environment, if it has one for all times.
        **env_kwargs: keywords of the environment; a policy's own options need not be repeated.

    Raises:
        ValueError: for an unknown environment or agent, or if the agent does not fit, looks into
            recordings, or goes through whole ones.
    """

    def __init__(
        self, env_id: str, agent: str | Path | Agent, values: Mapping[str, float] | None = None,
        nominal_noise: ArrayLike | None = None, **env_kwargs: Any,
    ) -> None:  # fmt: skip
        self.scenario, options = scenario_and_options(env_id, env_kwargs)
        self.agent = _find_agent(agent, self.scenario)
        self.agent.check(self.scenario, options, None)
        self._loop = Loop(self.scenario, replace(options, **self.agent.own_options), 1)
        if values is not None:
            self.agent = _with_values(self.agent, values, self._loop)
        motion, sensor = self.scenario.motion, self.scenario.sensor
        self.states = tuple(state.name for state in motion.states)
        self.channels = tuple(channel.name for channel in sensor.channels)
        self._given = nominal_noise
        self._count = -1  # of steps; before `reset` there is none
        self.time, self._updated = nan, np.full(1, nan)

    def reset(self, mean: ArrayLike, factor: ArrayLike | None = None, time: float = 0.0) -> None:
        """Begin a track; the agent forgets the last one.

        Args:
            mean: (n,) the initial estimate, at the time of the first measurement.
            factor: its (n,) standard deviations, or the lower Cholesky factor (n, n) of its
                covariance; by default the environment's deviations.
            time: of the first measurement, s; steps count on from it.

        Raises:
            ValueError: for a wrong length, NaN, or a factor that is none.
        """
        mean = _numbers("The initial mean", mean, len(self.states))
        factor = self.scenario.initial_factor if factor is None else factor
        self._loop.begin(np.zeros(1, np.int64), mean, _lower(factor, len(self.states)))
        self.agent.reset(self._briefing)
        self._count, self.time, self._updated = 0, float(time), np.array([float(time)])

    def step(
        self, z: ArrayLike, dt: float, u: ArrayLike | None = None, noise: ArrayLike | None = None,
        s: ArrayLike | None = None,
    ) -> Step:  # fmt: skip
        """Predict to a measurement, let the agent turn the knobs for it, and update.

        Args:
            z: (m,) what was measured, NaN in channels that are missing.
            dt: seconds since the last step. The first step after `reset` predicts nothing: there
                it tells for how long the knobs will hold, the usual interval.
            u: (p,) inputs of the motion over dt, where it has any.
            noise: (m,) deviations of the noise; `nominal_noise` by default.
            s: (k,) inputs of the sensor, where it has any; NaN only in those of missing channels.

        Raises:
            ValueError: for a wrong length, a NaN that is no missing channel, or a dt that is
                negative or too long.
            RuntimeError: before `reset`, or if the filter fails or has failed: it says why.
        """
        if self._count < 0:
            raise RuntimeError("The filter has no estimate yet: call reset(mean) first.")
        self._complain_of_failure()
        dt = _seconds(dt, self.scenario.longest_step)
        arrived, u = self._arrived(z, noise, s), self._driven(u)
        loop, passed = self._loop, np.zeros(1)
        if self._count > 0:
            passed[0] = dt
            loop.advance(u, arrived, passed, ONE)
            self.time += dt
        else:
            loop.look(arrived, passed, ONE)
        self._complain_of_failure()
        if self._count % loop.interval == 0:
            loop.turn(self._decide(arrived.noise, dt), ONE)
        due = self._count % self.scenario.steps_per_measurement == 0
        loop.correct(arrived, np.array([due]), ONE)
        self._complain_of_failure()
        self._count, self._updated = self._count + 1, np.array([self.time])
        mean, factor, nis = loop.latest.mean[0], loop.latest.factor[0], loop.latest.nis[0]
        return Step(self.time, mean.copy(), factor @ factor.T, float(nis), self.knobs)

    @property
    def knobs(self) -> dict[str, float]:
        """The factors that the agent set, by name."""
        factors = self._loop.factors[0, self._loop.knob_place].tolist()
        return {knob.name: factor for knob, factor in zip(self._loop.knobs, factors, strict=True)}

    @cached_property
    def nominal_noise(self) -> Array:
        """Deviations (m,) of the measurements where `step` is told none.

        Raises:
            ValueError: if the environment has none for all times and none was given.
        """
        if self._given is not None:
            return _deviations(self._given, len(self.channels))[0]
        calm = replace(self.scenario, faults="none")
        told = calm.sample([np.random.default_rng(0)]).noise[0]
        if not (told == told[0]).all():
            raise ValueError(
                f"The noise of {self.scenario.name} is another at each measurement: give step its "
                "deviations as noise, or the filter a nominal_noise."
            )
        return told[0]

    def save(self, path: str | Path) -> None:
        """Write the state of the track, whole or not at all: a file of plain arrays.

        Raises:
            RuntimeError: before `reset`.
            ValueError: if the agent's state is more than arrays.
        """
        if self._count < 0:
            raise RuntimeError("The filter has no state yet: call reset(mean) first.")
        write_state(Path(path), self._owner, self._state(), self.agent)

    def load(self, path: str | Path) -> None:
        """Go on with the track that a filter built alike has saved.

        Raises:
            FileNotFoundError: if there is no such file.
            ValueError: if it is none, is damaged, or another filter's; nothing changes then.
        """
        found = read_state(Path(path), self._owner, self._state())
        agent = copy(self.agent)
        agent.reset(self._briefing)
        restore(agent, found)
        for name, array in self._loop.state().items():
            array[...] = found[name]
        self.agent, self._count = agent, int(found["count"])
        self.time, self._updated = float(found["time"]), found["updated"].copy()

    def _state(self) -> dict[str, NDArray]:
        clock = {"count": np.array(self._count), "time": np.array(self.time)}
        return clock | {"updated": self._updated} | self._loop.state()

    @property
    def _owner(self) -> str:
        told = f"{self.agent.name} in {self.scenario.name}, {len(self.states)} states"
        if isinstance(self.agent, Learned):
            return f"{told}, policy {self.agent.policy.digest[:12]}"
        return f"{told}, {json.dumps(self.agent.values, sort_keys=True)}"

    @property
    def _briefing(self) -> Briefing:
        return Briefing(self._loop.knobs, self.scenario, 1, 0, None, self._loop.interval)

    def _decide(self, noise: Array, dt: float) -> Array:
        """The agent's action (1, K), as a contest asks for it."""
        observation, info = None, {}
        if self.agent.sees != "nothing":
            observation = self._loop.observe(noise, np.array([dt]), ONE)
        if self.agent.sees == "innovation":
            info = {"time": self._updated, **self._loop.tell(noise, ONE)}
        return np.minimum(np.maximum(self.agent.act(observation, info), -1.0), 1.0)

    def _arrived(self, z: ArrayLike, noise: ArrayLike | None, s: ArrayLike | None) -> Measurement:
        channels, inputs = len(self.channels), self.scenario.dimensions[1]
        value = _vector("The measurement z", z, channels)
        if any(map(isinf, value[0].tolist())):
            raise ValueError("The measurement z holds infinity: mark what is missing by NaN.")
        noise = self.nominal_noise if noise is None else noise
        known = _vector("The sensor's inputs s", () if s is None else s, inputs)
        return Measurement(known, value, _deviations(noise, channels))

    def _driven(self, u: ArrayLike | None) -> Array:
        inputs = self.scenario.dimensions[0]
        if u is None and self._count == 0:  # nothing is predicted
            return np.zeros((1, inputs))
        return _numbers("The motion's inputs u", () if u is None else u, inputs)

    def _complain_of_failure(self) -> None:
        if self._loop.status[0]:
            raise RuntimeError(
                f"The filter of {self.scenario.name} failed at {self.time:g} s, since "
                f"{FAILURES[self._loop.status[0]]}. Begin anew with reset."
            )


def _find_agent(named: str | Path | Agent, scenario: Any) -> Agent:
    """An agent of the filter's own.

    Raises:
        ValueError: if it is unknown, or none that goes from measurement to measurement.
    """
    found = copy(named) if isinstance(named, Contestant) else make_agent(str(named))
    found = found.suited_to(scenario)
    if not isinstance(found, Agent) or found.clairvoyant:
        raise ValueError(
            f"{found.name} needs a whole recording: name a rule, 'learned' or a policy's path."
        )
    return found


def _with_values(agent: Agent, values: Mapping[str, float], loop: Loop) -> Agent:
    known = [parameter.name for parameter in agent.tunable(loop.scenario, loop.knobs)]
    for name in values:
        if name not in known:
            raise ValueError(unknown(f"parameter of {agent.name}", name, known))
    return agent.with_values({**agent.values, **values})


def _vector(what: str, value: ArrayLike, size: int) -> Array:
    """As an array (1, size) of one's own."""
    array = np.array(value, dtype=np.float64)
    if array.shape != (size,):
        raise ValueError(f"{what} has the shape {array.shape}, and ({size},) belongs here.")
    return array[None]


def _numbers(what: str, value: ArrayLike, size: int) -> Array:
    array = _vector(what, value, size)
    if not all(map(isfinite, array[0].tolist())):
        raise ValueError(f"{what} holds NaN or infinity, which only a missing channel may have.")
    return array


def _deviations(noise: ArrayLike, size: int) -> Array:
    array = _numbers("The noise", noise, size)
    if not all(value > 0.0 for value in array[0].tolist()):
        raise ValueError("The noise holds standard deviations, and one of them is not positive.")
    return array


def _seconds(dt: float, longest: float) -> float:
    dt = float(dt)
    if not 0.0 <= dt <= longest:
        raise ValueError(
            f"dt must lie between 0 and {longest:g} s, got {dt!r}: over a longer gap take steps "
            "in between whose z is NaN."
        )
    return dt


def _lower(factor: ArrayLike, size: int) -> Array:
    """Standard deviations or a lower factor as a lower factor (1, n, n)."""
    array = np.array(factor, dtype=np.float64)
    array = np.diag(array) if array.ndim == 1 else array
    if array.shape != (size, size):
        raise ValueError(
            f"The initial factor has the shape {np.shape(factor)}, and ({size},) or "
            f"({size}, {size}) belongs here."
        )
    positive = np.isfinite(array).all() and (np.diagonal(array) > 0.0).all()
    if not positive or np.triu(array, 1).any():
        raise ValueError(
            "The initial factor must hold positive standard deviations, or be lower triangular "
            "with a positive diagonal: give np.linalg.cholesky of the covariance."
        )
    return array[None]
