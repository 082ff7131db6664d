"""`kfenv tune`: static noise recovered, as an independent library finds it; its report."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from kfenv.agents.cli.app import app
from kfenv.agents.contest.rollout import scenario_and_options
from kfenv.agents.tuning.blocks import blocks_of
from kfenv.agents.tuning.criteria import Criterion
from kfenv.agents.tuning.diagnostics import Innovations, channel_report, lag_correlations
from kfenv.agents.tuning.estimation import estimate
from kfenv.agents.tuning.findings import as_yaml, lines_to_paste, warnings
from kfenv.agents.tuning.noise import NoiseShape
from kfenv.agents.tuning.study import Study, run_study
from plot_files import of_episode
from rollouts import BISTATIC, draw
from scipy.optimize import minimize
from typer.testing import CliRunner

from kfenv.models.model import Component
from kfenv.models.namespaces import batch
from kfenv.scenarios.radar.tracking import RadarTracking
from kfenv.scenarios.recording import stack

RINEX = Path(__file__).parents[2] / "shared" / "data" / "rinex"
BUS = RINEX / "bus_phone.20o", RINEX / "bus_phone.20n"
CALM = {"faults": "none", "duration": 12.0, "rate": 5.0}
TRUE_Q, TRUE_R = 4.0, np.array([3.0, 0.5, 1.0])  # over the told variance, and deviations


def moved_as_believed(episodes, q=TRUE_Q, r=TRUE_R, seed=0):
    """Episodes of a linear target whose Q and R are these factors of the told ones."""
    scenario, _ = scenario_and_options(BISTATIC, CALM)
    recording = draw(BISTATIC, range(episodes), **CALM)
    rng, functions = np.random.default_rng(seed), scenario.motion.build(batch)
    dt = recording.time[1] - recording.time[0]
    state = recording.mean + rng.standard_normal(recording.mean.shape) * np.diagonal(
        recording.factor, axis1=1, axis2=2
    )
    truth = [state]
    for _ in recording.time[1:]:
        factor = np.zeros((9, 9))
        entries = functions.noise_factor(tuple(state.T), (), dt)
        for (i, j), entry in zip(scenario.motion.noise_pattern, entries, strict=True):
            factor[i, j] = np.ravel(entry)[0]
        drawn = rng.standard_normal(state.shape) @ factor.T
        state = np.stack(functions.step(tuple(state.T), (), dt), axis=1) + np.sqrt(q) * drawn
        truth.append(state)
    truth = np.stack(truth, axis=1)
    place = list(scenario.motion.position)
    noise = r * recording.noise * rng.standard_normal(recording.noise.shape)
    return replace(
        recording, truth=truth, measurement=truth[..., place] + noise, true_noise=None
    ), factor


def estimated(recording, on="likelihood", shape="groups"):
    scenario, options = scenario_and_options(BISTATIC, CALM)
    shape = NoiseShape.of(shape, scenario, recording)
    criterion = Criterion(on, scenario, options, recording, blocks_of(recording))
    return shape, estimate(shape, criterion, 0)


@pytest.mark.parametrize("on", ["likelihood", "consistency", "withheld", "error"])
def test_known_noise_is_recovered_within_its_interval(on):
    shape, found = estimated(moved_as_believed(16)[0], on)
    wanted = np.log([TRUE_Q, *TRUE_R])
    assert shape.names == ("process_noise", "x_noise", "y_noise", "z_noise")
    inside = (found.low <= wanted) & (wanted <= found.high)
    assert inside.all() and found.blocks == 16 and found.cost < found.nominal_cost
    if on == "likelihood":
        assert np.abs(found.theta - wanted).max() < 0.5 and found.moved.all()
        assert (found.high - found.low).max() < 2.0 and not found.at_edge.any()


def test_its_intervals_cover():
    """Of a dozen logs some nine in ten hold what is true."""
    wanted, hits = np.log([TRUE_Q, *TRUE_R]), []
    for seed in range(12):
        _, found = estimated(moved_as_believed(8, seed=seed)[0])
        hits.append((found.low <= wanted) & (wanted <= found.high))
    assert 0.85 < np.mean(hits) <= 1.0


def test_an_independent_library_finds_the_same_maximum():
    """SciPy over FilterPy's likelihood, equal within one per cent."""
    kalman = pytest.importorskip("filterpy.kalman")
    recording, q_factor = moved_as_believed(4)
    shape, found = estimated(recording)
    scenario = shape.scenario
    dt = recording.time[1] - recording.time[0]
    step = scenario.motion.build(batch).step
    transition = np.stack(step(tuple(np.eye(9)), (), dt), axis=0)
    position = list(scenario.motion.position)

    def cost(theta):
        total = 0.0
        for b in range(len(recording)):
            other = kalman.KalmanFilter(9, 3)
            other.x, other.P = recording.mean[b], recording.factor[b] @ recording.factor[b].T
            other.F, other.Q = transition, np.exp(theta[0]) * q_factor @ q_factor.T
            other.H = np.eye(9)[position]
            for t in range(len(recording.time)):
                if t > 0:
                    other.predict()
                other.R = np.diag((np.exp(theta[1:]) * recording.noise[b, t]) ** 2)
                other.update(recording.measurement[b, t])
                total -= other.log_likelihood
        return total

    best = minimize(cost, found.theta + 0.1, method="L-BFGS-B", options={"maxiter": 30})
    np.testing.assert_allclose(np.exp(found.theta), np.exp(best.x), rtol=0.01)
    count = recording.measurement.size
    assert found.cost * count == pytest.approx(best.fun, rel=1e-4)


def test_a_full_matrix_takes_the_models_own_where_it_is_right():
    """Factors of each state's deviation, couplings at zero: no better than its intervals tell."""
    recording, _ = moved_as_believed(6, q=1.0, r=np.ones(3))
    shape = NoiseShape.of("full", scenario_and_options(BISTATIC, CALM)[0], recording)
    left, noise = shape.factors(np.zeros((1, len(shape.names))))
    np.testing.assert_array_equal(left[0], np.eye(9))
    np.testing.assert_array_equal(noise[0], np.ones(3))
    theta = np.zeros((1, len(shape.names)))
    theta[0, shape.names.index("vx_process_noise")] = np.log(4.0)
    theta[0, shape.names.index("x into vx")] = 0.5
    left, _ = shape.factors(theta)
    ratio = shape.size[1] / shape.size[0]
    assert left[0, 1, 1] == 2.0 and left[0, 1, 0] == pytest.approx(ratio)


def test_each_source_of_process_noise_has_its_own_factor():
    """An axis that moves more than told, and two as told."""
    recording, _ = moved_as_believed(12, q=np.repeat([9.0, 1.0, 1.0], 3), r=np.ones(3))
    shape, found = estimated(recording, shape="sources")
    assert shape.names[:3] == ("x_process_noise", "y_process_noise", "z_process_noise")
    wanted = np.log([9.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    assert ((found.low <= wanted) & (wanted <= found.high)).all()
    assert np.abs(found.theta - wanted).max() < 0.8


def test_what_no_data_moves_is_told():
    """A channel that never arrives has a noise that nothing depends on."""
    recording, _ = moved_as_believed(10)
    measurement = recording.measurement.copy()
    measurement[..., 2] = np.nan
    _, found = estimated(replace(recording, measurement=measurement))
    assert found.moved.tolist() == [True, True, True, False]
    assert np.isinf(found.high[3] - found.low[3])


def test_few_windows_are_cut_into_blocks_in_time():
    recording, _ = moved_as_believed(1)
    blocks = blocks_of(recording)
    assert blocks.max() == 9 and (np.diff(blocks[0]) >= 0).all()


def test_windows_that_overlap_share_their_blocks():
    """Of one long log, drawn at random: the same instant is in the same block, others are not."""
    long, _ = moved_as_believed(2)
    starts, length = [(0, 20), (0, 5), (1, 0), (0, 12), (0, 38)], 22
    windows = [
        replace(long[e], **{
            name: getattr(long[e], name)[:, start : start + length]
            for name in ("measurement", "noise", "motion_inputs", "sensor_inputs", "truth",
                         "true_bias")
        }, time=long.time[:length])
        for e, start in starts
    ]  # fmt: skip
    blocks = blocks_of(stack(windows))
    told = {}
    for (e, start), own in zip(starts, blocks, strict=True):
        for t, block in enumerate(own):
            assert told.setdefault((e, start + t), block) == block
    assert not {b for (e, _), b in told.items() if e} & {b for (e, _), b in told.items() if not e}
    assert blocks.max() + 1 >= 10
    alone = blocks_of(moved_as_believed(12)[0])
    np.testing.assert_array_equal(alone, np.repeat(np.arange(12)[:, None], 61, axis=1))


def test_a_channels_report_is_of_its_own_unit():
    rng = np.random.default_rng(0)
    value = np.radians(0.3 + 2.0 * rng.standard_normal((20, 50, 1)))
    value[:, ::7] = np.nan
    told = Innovations(value, np.full(value.shape, np.radians(1.0) ** 2), value[..., 0], None)
    blocks = np.repeat(np.arange(20)[:, None], 50, axis=1)
    found = channel_report(Component("azimuth", "rad", "azimuth", angle=True), told, 0, blocks)
    assert found.unit == "deg" and found.count == np.isfinite(value).sum()
    assert found.mean_low < 0.3 < found.mean_high and found.mean_high < 0.7
    assert found.deviation == pytest.approx(2.0, rel=0.1)
    assert found.expected == pytest.approx(1.0)
    assert found.nis == pytest.approx(4.1, rel=0.15) and found.nis_high < 1.2
    assert np.abs(found.lags).max() < 2.5 * found.lag_bound + 0.05
    assert sum(found.histogram) == pytest.approx(1.0)


def test_correlations_skip_what_did_not_arrive():
    series = np.array([[1.0, np.nan, 1.0, np.nan, 1.0, 1.0], [np.nan, 1.0, -1.0, 1.0, -1.0, 1.0]])
    assert lag_correlations(series)[0] == pytest.approx((3.0 - 4.0) / 9.0)


def report(**changes):
    """A report in which all is well, but for what is changed."""
    row = {"value": 1.1, "low": 0.9, "high": 1.3, "moved": True, "at_edge": False,
           "what": "deviation"}  # fmt: skip
    channel = {"name": "range", "unit": "m", "biased": False, "mean": 3.0, "mean_low": 2.0,
               "mean_high": 4.0, "outlying": 0.0}  # fmt: skip
    rule = {"name": "nis-gate", "fired": 0.1}
    row, channel, rule = ({**x, **{k: v for k, v in changes.items() if k in x}}
                          for x in (row, channel, rule))  # fmt: skip
    return {"by": ["likelihood"], "static": {"likelihood": {"parameters": {"range_noise": row}}},
            "channels": [channel], "rules": [rule]}  # fmt: skip


@pytest.mark.parametrize(("changes", "said"), [
    ({}, None),
    ({"value": 3.0, "low": 2.0, "high": 4.0}, "range is off by a factor of 3 .2 to 4.*tell"),
    ({"value": 3.0, "low": 0.9, "high": 9.0}, None),
    ({"moved": False}, "No data moved range_noise"),
    ({"at_edge": True}, "end of its range"),
    ({"biased": True}, "range is biased by 3 m .2 to 4"),
    ({"outlying": 0.03}, "3 % of range .*robust rule"),
    ({"fired": 0.0}, "nis-gate fires hardly ever"),
    ({"fired": 0.9}, "nis-gate fires nearly always .90 %"),
])  # fmt: skip
def test_a_warning_names_what_is_wrong_and_the_remedy(changes, said):
    told = warnings(report(**changes))
    if said is None:
        assert told == []
    else:
        [sentence] = told
        assert re.search(said, sentence)


@pytest.mark.skipif(not BUS[0].exists(), reason="needs ../shared/data/rinex/bus_phone.20o")
@pytest.mark.filterwarnings("ignore:.*ephemerides")
def test_a_real_phones_log_is_tuned_without_truth(tmp_path):
    """Its innovations, together and those of pseudoranges, are near one where none was tuned."""
    kwargs = {"rinex": list(map(str, BUS)), "moving": True, "duration": 30.0}
    told = run_study(Study("kfenv/GnssTracking-v0", kwargs, episodes=8), tmp_path)
    nominal, tuned = told["nominal"]["nis"], told["static"]["likelihood"]["nis"]
    assert nominal["rate"] < 0.1 and nominal["all"] > 2.0
    assert 0.5 < tuned["all"] < 2.0 and 0.5 < tuned["pseudorange"] < 2.0
    assert tuned["rate"] > 5.0 * nominal["rate"]


def test_a_radars_own_plots_are_tuned_without_truth(tmp_path):
    """One long log of plots in windows, told deviations that are three times too small."""
    scenario = RadarTracking(rate=1.0, duration=240.0, faults="none")
    episode = scenario.sample([np.random.default_rng(5)])
    path = of_episode(tmp_path / "plots.csv", scenario.sensor,
                      replace(episode, noise=episode.noise / 3.0))  # fmt: skip
    out = tmp_path / "out"
    few = ["--option", "duration=20", "--episodes", "12", "--output", str(out)]
    command = ["tune", "kfenv/RadarTracking-v0", "--plots", path, *few]
    told = CliRunner().invoke(app, command)
    assert told.exit_code == 0, told.output
    found = json.loads((out / "report.json").read_text())
    assert 0.5 < found["static"]["likelihood"]["nis"]["all"] < 2.0 < found["nominal"]["nis"]["all"]


def test_the_command_tells_and_goes_on(tmp_path):
    """Tables, YAML, report and figures; a study that grows repeats nothing, another is refused."""
    out = tmp_path / "out"
    few = ["tune", BISTATIC, "--option", "duration=6", "--faults", "none", "--episodes", "10",
           "--test-episodes", "6", "--output", str(out)]  # fmt: skip
    told = CliRunner().invoke(app, few)
    assert told.exit_code == 0, told.output
    assert "R = diag([" in told.output and "process_noise" in told.output
    found = json.loads((out / "report.json").read_text())
    assert {row["name"] for row in found["channels"]} == {"x", "y", "z"}
    text = (out / "noise.yaml").read_text()
    assert text == as_yaml(found)
    read = dict(line.split(": ", 1) for line in text.splitlines() if ": " in line)
    assert json.loads(read["R_diagonal"]) == pytest.approx(found["matrices"]["R"], rel=1e-4)
    rows = [json.loads(line[4:]) for line in text.split("Q:\n")[1].splitlines()]
    np.testing.assert_allclose(rows, found["matrices"]["Q"], rtol=1e-4)
    assert (out / "innovations.png").stat().st_size > 5000
    namespace = {"diag": np.diag, "array": np.array}
    for line in lines_to_paste(found):
        exec(line, namespace)
    np.testing.assert_allclose(np.diag(namespace["R"]), found["matrices"]["R"], rtol=1e-3)
    before = (out / "jobs" / "static-likelihood.json").stat().st_mtime_ns
    assert CliRunner().invoke(app, few).exit_code == 2
    grown = CliRunner().invoke(app, [*few, "--resume", "--by", "likelihood", "--by", "withheld",
                                     "--rule", "huber-gate", "--trials", "2"])  # fmt: skip
    assert grown.exit_code == 2 and "another study" in grown.output
    grown = CliRunner().invoke(app, [*few, "--resume", "--by", "likelihood", "--by", "withheld"])
    assert grown.exit_code == 0, grown.output
    assert (out / "jobs" / "static-likelihood.json").stat().st_mtime_ns == before
