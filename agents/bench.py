"""Speed, as ratios within one run: machines differ, and so do their loads."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

import kfenv  # noqa: F401  (registers the environments)
from kfenv.filters.engine import Engine
from kfenv.filters.results import Run
from kfenv.models.namespaces import scalar
from kfenv.scenarios.gnss.tracking import GnssTracking
from kfenv.scenarios.radar.tracking import RadarTracking
from kfenv.scenarios.recording import Recording
from kfenv.scenarios.scenario import TrackingScenario

from . import environment_speed, own_speed

ENV_ID = "kfenv/RadarTracking-v0"
FILTERS = 1024
SUB_ENVIRONMENTS = 256


class Row(NamedTuple):
    """One line of the table: what, how fast, compared with what, and the promise."""

    what: str
    figure: str
    compared: str
    promised: str


def benchmark(advance: Callable[[str], None] = lambda what: None) -> list[Row]:
    """Run all benchmarks, one core each; takes about a minute."""
    rows = []
    for name, measure in (
        ("engine", _engine_rows),
        ("models of one's own", _own_rows),
        ("environments", _environment_rows),
        ("vector environments", _vector_rows),
        ("start-up", _start_up_rows),
    ):
        advance(name)
        rows.extend(measure())
    return rows


def _best(repeat: int, function: Callable[[], Any]) -> float:
    """Shortest of several times, s: what the machine can do when nobody disturbs it."""
    times = []
    for _ in range(repeat):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return min(times)


def _engine_rows() -> list[Row]:
    scenario = RadarTracking(duration=5.0, faults="none")
    run, steps, recording = _engine_run(scenario)
    filterpy = _filterpy_filter(scenario, recording)
    satellites = GnssTracking(duration=5.0, faults="none")
    others = [_engine_run(replace(satellites, measurement_rate=rate))[0] for rate in (10.0, 1.0)]
    # In turn, so that a drift of the machine's speed meets all.
    ours, theirs, gnss = [], [], []
    for _ in range(4):
        ours.append(steps / _best(2, run))
        gnss.append([steps / _best(2, other) for other in others])
        if filterpy is not None:
            theirs.append(len(recording.time) / _best(2, filterpy))
    speed = max(ours)
    every, tenth = np.max(gnss, axis=0)
    if not theirs:
        ratio = "FilterPy is not installed"
    else:
        ratio = f"{speed / max(theirs):,.0f} x FilterPy's UKF ({max(theirs):,.0f} steps/s)"
    what = f"engine, n=9, m=3, variable turn, {FILTERS} filters"
    part = f"{every / speed:.0%} and {tenth / speed:.0%} of the radar's"
    return [
        Row(what, f"{speed:,.0f} steps/s", ratio, "200 x FilterPy"),
        Row("the same, n=11, m=24, GNSS: measured at every step, at every tenth",
            f"{every:,.0f}, {tenth:,.0f} steps/s", part, ""),
    ]  # fmt: skip


def _own_rows() -> list[Row]:
    speed = own_speed.measured(_best)
    ratio = speed["own"] / speed["built-in"]
    first = "engine, n=9, m=3, constant acceleration in a user's words"
    rows = [Row(first, f"{speed['own']:,.0f} steps/s", f"{ratio:.2f} x the built-in one", "0.9 x")]
    what = "NumPy functions, n=4, m=2, a batch of {}"
    for name, count, promised in (("alone", 1, "1 x"), ("together", own_speed.TOGETHER, "20 x")):
        told = f"1/{speed['engine'] / speed[name]:.0f} of the engine's for {own_speed.TOGETHER}"
        if "FilterPy" in speed:
            told = f"{speed[name] / speed['FilterPy']:.1f} x FilterPy's UKF, {told}"
        rows.append(Row(what.format(count), f"{speed[name]:,.0f} steps/s", told,
                        f"{promised} FilterPy"))  # fmt: skip
    return rows


def _engine_run(scenario: TrackingScenario) -> tuple[Callable[[], Run], int, Recording]:
    """A call that filters episodes of a scenario, the number of its steps, and the episodes."""
    recording = scenario.sample([np.random.default_rng(i) for i in range(FILTERS)])
    run = partial(Engine(scenario.motion, scenario.sensor).run, recording)
    run()
    return run, FILTERS * len(recording.time), recording


def _filterpy_filter(scenario: RadarTracking, recording) -> Callable[[], None] | None:
    """FilterPy's UKF over the first episode, its model in plain floats and Q held constant."""
    try:
        from filterpy.kalman import JulierSigmaPoints, UnscentedKalmanFilter
    except ImportError:
        return None
    functions, measure = scenario.motion.build(scalar), scenario.sensor.build(scalar)
    dt = 1.0 / scenario.rate

    def run() -> None:
        ukf = UnscentedKalmanFilter(
            9, 3, dt,
            hx=lambda x: np.array(measure(x.tolist(), ())),
            fx=lambda x, dt: np.array(functions.step(x.tolist(), (), dt)),
            points=JulierSigmaPoints(9, 1.0),
        )  # fmt: skip
        ukf.x, ukf.P = recording.mean[0].copy(), recording.factor[0] @ recording.factor[0].T
        factor = np.zeros((9, 9))
        entries = functions.noise_factor(recording.mean[0].tolist(), (), dt)
        for (i, j), value in zip(scenario.motion.noise_pattern, entries, strict=True):
            factor[i, j] = value
        ukf.Q = factor @ factor.T
        for t in range(len(recording.time)):
            ukf.predict()
            ukf.update(recording.measurement[0, t], R=np.diag(recording.noise[0, t] ** 2))

    return run


def _environment_rows() -> list[Row]:
    vector = gym.make_vec(ENV_ID, num_envs=SUB_ENVIRONMENTS, autoreset_mode="same_step")
    vector.reset(seed=0)
    action = np.zeros(vector.action_space.shape, np.float32)
    vector.step(action)  # compiles

    def episodes() -> None:
        for _ in range(400):
            vector.step(action)

    # Three rounds pass an episode's end, so that drawing new episodes is counted.
    start = time.perf_counter()
    for _ in range(3):
        episodes()
    speed = 3 * 400 * SUB_ENVIRONMENTS / (time.perf_counter() - start)
    many = gym.make_vec(ENV_ID, num_envs=FILTERS)
    many.reset(seed=0)
    begun = _best(3, many.reset)
    single = gym.make(ENV_ID)
    single.reset(seed=0)
    zero, times = np.zeros(single.action_space.shape, np.float32), []
    for _ in range(1000):
        start = time.perf_counter()
        single.step(zero)
        times.append(time.perf_counter() - start)
    what = f"vector environment, {SUB_ENVIRONMENTS} sub-environments, resets included"
    return [
        Row(what, f"{speed:,.0f} steps/s", "", "150,000 steps/s"),
        Row(f"reset of {FILTERS} sub-environments", f"{begun:.2f} s",
            f"{1e3 * begun / FILTERS:.2f} ms an episode", "0.2 s"),
        Row("single env.step, median", f"{np.median(times) * 1e6:.0f} us", "", "40 us"),
    ]  # fmt: skip


def _vector_rows() -> list[Row]:
    speed = environment_speed.measured(ENV_ID, _best)
    few, many = environment_speed.FEW, environment_speed.MANY
    part = speed["environments"] / speed["engine"]
    gain = speed["two threads"] / speed["one thread"]
    return [
        Row(f"the same without resets, {few} sub-environments",
            f"{speed['environments']:,.0f} steps/s", f"{part:.2f} x the engine alone", "0.6 x"),
        Row(f"the same, {many} sub-environments in two threads",
            f"{speed['two threads']:,.0f} steps/s", f"{gain:.2f} x one thread", "1.8 x"),
    ]  # fmt: skip


def _start_up_rows() -> list[Row]:
    step = (
        "import time; start = time.perf_counter(); import gymnasium, kfenv;"
        f"env = gymnasium.make({ENV_ID!r}); env.reset(seed=0);"
        "env.step(env.action_space.sample()); print(time.perf_counter() - start)"
    )
    bare = "import time; s = time.perf_counter(); import kfenv; print(time.perf_counter() - s)"
    with tempfile.TemporaryDirectory() as cache:
        cold = _in_new_process(step, cache)
        warm = min(_in_new_process(step, cache) for _ in range(3))
    plain = min(_in_new_process(bare, None) for _ in range(3))
    return [
        Row("import kfenv", f"{plain:.2f} s", "", "0.5 s"),
        Row("import, make, reset, step: cold", f"{cold:.1f} s", "", "10 s"),
        Row("the same with a warm cache", f"{warm:.2f} s", f"{cold / warm:.0f} x faster", "1 s"),
    ]


def _in_new_process(program: str, cache: str | None) -> float:
    environment = dict(os.environ)
    if cache is not None:
        environment["NUMBA_CACHE_DIR"] = cache
    output = subprocess.run(
        [sys.executable, "-c", program], env=environment, check=True, capture_output=True, text=True
    )
    return float(output.stdout.split()[-1])
