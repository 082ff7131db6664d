"""Tuning on what measurements alone tell: likelihood, consistency, withheld measurements."""

import json

import numpy as np
import pytest
from kfenv.agents.cli.app import app
from kfenv.agents.contest.rollout import draw_episodes, rollout
from kfenv.agents.contest.tuning import tune
from kfenv.agents.contest.tuning_costs import COSTS, PERIOD, costs, measured, withhold
from kfenv.agents.contestants.registry import make_agent
from rollouts import BISTATIC, INERTIAL, TRACKING, change, draw, make, short
from typer.testing import CliRunner

LABEL_FREE = tuple(name for name in COSTS if name not in ("error", "axes"))
CALM = {"faults": "none", "duration": 12.0, "rate": 5.0}


@pytest.mark.parametrize("on", LABEL_FREE)
@pytest.mark.parametrize("agent", ["fixed", "huber-gate", "innovation-noise"])
def test_no_truth_is_needed_to_tune(on, agent):
    recording = draw(TRACKING, range(4))
    blind = change(recording, truth=None, true_noise=None)
    place = TRACKING, short(TRACKING)
    told = [costs(on, make_agent(agent), *place, given, 0) for given in (recording, blind)]
    np.testing.assert_array_equal(*told)
    assert told[0].shape == (4,) and np.isfinite(told[0]).all()


@pytest.mark.parametrize("env_id", [BISTATIC, INERTIAL])
def test_what_is_withheld_never_reaches_the_filter(env_id):
    """Spoilt beyond measure it costs more, and changes no estimate."""
    recording = draw(env_id, range(2), duration=8.0)
    met, kept = withhold(recording)
    arrived = np.isfinite(recording.measurement).any(axis=2).sum(axis=1)
    assert (np.isfinite(kept).any(axis=2).sum(axis=1) == arrived // PERIOD * 3
            + np.maximum(arrived % PERIOD - 9, 0)).all()  # fmt: skip
    assert not (np.isfinite(kept) & np.isfinite(met.measurement)).any()
    spoilt = change(recording, measurement=np.where(np.isnan(kept), recording.measurement, 1e9))
    place = env_id, short(env_id, duration=8.0)
    gate, both = make_agent("huber-gate"), (recording, spoilt)
    scores = [rollout(gate, *place, withhold(each)[0]).rmse for each in both]
    np.testing.assert_array_equal(*scores)
    told = [costs("withheld", gate, *place, each, 0) for each in both]
    assert (told[0] < 2.0).all() and (told[1] > 5.0).all()


def test_a_filter_that_goes_through_recordings_is_tuned_on_withheld_ones_too():
    """The family's filter is the environment's, and foresees the same."""
    recording, place = draw(BISTATIC, range(2), duration=8.0), (BISTATIC, short(BISTATIC))
    told = [costs("withheld", make_agent(name), *place, recording, 0)
            for name in ("fixed", "srukf-joseph-exact")]  # fmt: skip
    np.testing.assert_allclose(*told, rtol=1e-9)
    with pytest.raises(ValueError, match=r"okf turns no knobs.*'error' or 'withheld'"):
        costs("likelihood", make_agent("okf"), *place, recording, 0)


def test_the_sensor_says_what_a_state_measures():
    recording = draw(TRACKING, [0], faults="none")
    sensor = make(TRACKING).scenario.sensor
    off = measured(sensor, recording.truth, recording.sensor_inputs) - recording.measurement
    assert np.abs(off / recording.noise).max() < 6.0


@pytest.mark.parametrize("on", ["likelihood", "consistency"])
def test_a_sensor_told_three_times_too_good_is_found_out(on):
    recording = draw_episodes(BISTATIC, CALM, "tuning", 0, 6)
    recording = change(recording, noise=recording.noise / 3.0)
    agent = tune(make_agent("fixed-tuned"), BISTATIC, CALM, recording, 16, 0, on=on)
    off = [np.abs(np.log(np.mean(rollout(each, BISTATIC, CALM, recording).nis[:, 0])))
           for each in (agent, make_agent("fixed"))]  # fmt: skip
    assert off[1] > 1.0 and off[0] < 0.6 * off[1]
    if on == "likelihood":
        assert off[0] < 0.25 and agent.values["x_noise"] == pytest.approx(3.0, rel=0.25)


def test_the_command_tunes_on_what_it_is_told(tmp_path):
    runner, chosen = CliRunner(), []
    for on in ("error", "likelihood"):
        told = runner.invoke(app, [
            "evaluate", BISTATIC, "--option", "duration=5", "--agent", "huber-gate", "--episodes",
            "6", "--tuning-episodes", "4", "--tuning-trials", "3", "--processes", "1", "--tune-on",
            on, "--output", str(tmp_path / on)])  # fmt: skip
        assert told.exit_code == 0, told.output
        assert json.loads((tmp_path / on / "contest.json").read_text())["tune_on"] == on
        with np.load(tmp_path / on / "scores" / "huber-gate.npz") as scores:
            chosen.append(scores["values"])
    assert not np.allclose(*chosen)
    told = runner.invoke(app, ["evaluate", BISTATIC, "--tune-on", "truth", "--output",
                               str(tmp_path / "no")])  # fmt: skip
    assert told.exit_code == 2 and "withheld" in told.output


def test_neither_axis_is_bought_by_the_other():
    """The fixed filter costs one; halving one axis is worth as much as halving the other."""
    recording, place = draw(BISTATIC, range(4)), (BISTATIC, short(BISTATIC))
    both = [make_agent(name) for name in ("fixed", "huber-gate")]
    told = [costs("axes", agent, *place, recording, 0).mean() for agent in both]
    offs = [rollout(agent, *place, recording, trace=True).off for agent in both]
    horizontal, vertical = ([np.sum(off[..., a] ** 2) for off in offs] for a in ([0, 1], [2]))
    wanted = 0.5 * (horizontal[1] / horizontal[0] + vertical[1] / vertical[0])
    assert told == [pytest.approx(1.0), pytest.approx(wanted)]
