"""A filter fed by hand goes through the same bits as the environment that replays a recording."""

import re
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from kfenv.agents.contest.rollout import scenario_and_options, without_truth
from kfenv.agents.contestants.agent import Briefing
from kfenv.agents.contestants.learned import OWN_OPTIONS
from kfenv.agents.contestants.pretrained import FOLDER
from kfenv.agents.contestants.registry import AGENTS, make_agent
from kfenv.agents.deployment import TunedFilter
from pendulum import MODEL, WORLD
from policies import trained_on
from rollouts import (
    BISTATIC,
    GNSS,
    INERTIAL,
    OWN,
    TRACKING,
    VALIDATION,
    draw,
    every_environment,
    short,
)

from kfenv.models.own import own_motion, own_sensor

README = Path(__file__).parents[1] / "README.md"
F = np.array([[1.0, 0.1], [0.0, 1.0]])
RULES = ("hmm-noise", "pooled-noise", "innovation-noise")
SPARSE = {"rate": 20.0, "measurement_rate": 5.0}  # a decision for each fourth step


def replayed(env_id, agent, recording, kwargs):
    """The environment with its agent: mean, factor, NIS and knobs by the instant's index."""
    scenario, options = scenario_and_options(env_id, kwargs)
    agent = make_agent(str(agent)).suited_to(scenario)
    options = replace(options, recording=recording, **agent.own_options)
    own = {name: getattr(options, name) for name in OWN_OPTIONS}
    env = gym.make(env_id, recording=recording, **(kwargs | own)).unwrapped
    env.reset(seed=0)
    core, over, found = env.core, False, {}
    agent.reset(Briefing(core.knobs, scenario, 1, 0, None, core.interval))
    while not over:
        action = np.clip(agent.act(core.observation(), without_truth(core)), -1.0, 1.0)
        *_, lost, ended, info = env.step(action[0])
        over, latest = lost or ended, core.latest
        at = core.index[0] - (not lost)
        found[at] = latest.mean[0].copy(), latest.factor[0].copy(), latest.nis[0], info["knobs"]
    return found


def feed(tuned, recording, begin=0, end=None):
    """Step through instants of a recording's first episode."""
    first = recording.time[1] - recording.time[0]
    steps = np.append(first, np.diff(recording.time))
    return [
        tuned.step(
            recording.measurement[0, t], steps[t], recording.motion_inputs[0, t],
            recording.noise[0, t], recording.sensor_inputs[0, t],
        )
        for t in range(begin, len(steps) if end is None else end)
    ]  # fmt: skip


def begun(env_id, agent, recording, kwargs):
    tuned = TunedFilter(env_id, agent, **kwargs)
    tuned.reset(recording.mean[0], recording.factor[0], recording.time[0])
    return tuned


def assert_same_bits(env_id, agent, kwargs, seed=0):
    recording = draw(env_id, [seed], **kwargs)
    wanted = replayed(env_id, agent, recording, kwargs)
    got = feed(begun(env_id, agent, recording, kwargs), recording, end=max(wanted) + 1)
    assert len(wanted) > 5
    for at, (mean, factor, nis, knobs) in wanted.items():
        np.testing.assert_array_equal(got[at].estimate, mean)
        np.testing.assert_array_equal(got[at].covariance, factor @ factor.T)
        np.testing.assert_array_equal(got[at].nis, nis)
        assert got[at].knobs == knobs
        assert got[at].time == recording.time[at]
    return got


@every_environment
@pytest.mark.parametrize("rule", RULES)
def test_a_rule_gives_the_bits_of_the_environment(env_id, rule):
    got = assert_same_bits(env_id, rule, short(env_id))
    assert len({step.knobs["process_noise"] for step in got}) == 1
    assert any(step.knobs != got[0].knobs for step in got)  # it did turn knobs


@every_environment
def test_a_policy_gives_the_bits_of_the_environment(env_id, tmp_path):
    """Of the full observation, with a memory of its own."""
    kwargs = short(env_id)
    policy = trained_on(tmp_path / "policy.npz", env_id, observation="full", **kwargs)
    assert_same_bits(env_id, policy, kwargs)


@pytest.mark.parametrize("env_id", [TRACKING, BISTATIC])
def test_the_learned_agent_gives_the_bits_of_the_environment(env_id):
    assert_same_bits(env_id, "learned", {"duration": 20.0, "rate": 2.0}, seed=3)


@every_environment
def test_whatever_agent_comes_with_kfenv_gives_the_bits_of_the_environment(env_id):
    if (FOLDER / f"{env_id[6:-3]}.npz").is_file():
        assert_same_bits(env_id, "learned", short(env_id))


@pytest.mark.parametrize("agent", ["hmm-noise", "policy"])
def test_a_decision_holds_from_one_measurement_to_the_next(agent, tmp_path):
    kwargs = short(INERTIAL, **SPARSE)
    if agent == "policy":
        agent = trained_on(tmp_path / "policy.npz", INERTIAL, observation="full", **kwargs)
    got = assert_same_bits(INERTIAL, agent, kwargs)
    assert all(step.knobs == got[i - i % 4].knobs for i, step in enumerate(got))


def test_a_model_of_ones_own_gives_the_bits_of_the_environment():
    """An angle as the only channel, compiled; its noise is R."""
    kwargs = MODEL | WORLD | {"duration": 2.0}
    assert_same_bits(OWN, "pooled-noise", kwargs)
    tuned = TunedFilter(OWN, "pooled-noise", **kwargs)
    assert tuned.nominal_noise == pytest.approx([0.1])
    assert (tuned.states, tuned.channels) == (("angle", "rate"), ("angle",))


def test_plain_functions_give_the_bits_of_the_environment():
    motion = own_motion(("place", "speed"), lambda x, u, dt: F @ x, Q=(0.0, 0.1))
    kwargs = {"motion": motion, "sensor": own_sensor(("place",), lambda x, s: x[:1], states=2)}
    kwargs |= {"scored": ("place",), "scale": 1.0, "R": (1.0,), "mean": (0.0, 1.0)}
    assert_same_bits(OWN, "hmm-noise", kwargs | {"P": (1.0, 1.0), "rate": 10.0, "duration": 3.0})


def test_the_readme_tells_the_truth(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    section = README.read_text().partition("## Out again")[2]
    exec(re.search(r"```python\n(.*?)```", section, re.DOTALL)[1], {})
    assert len(capsys.readouterr().out.splitlines()) == 6
    assert (tmp_path / "track.npz").exists()


def test_single_channels_have_their_knobs():
    assert_same_bits(GNSS, "satellite-hmm", short(GNSS))


def test_a_rule_takes_its_tuned_parameters():
    tuned = TunedFilter(BISTATIC, "hmm-noise", {"process_noise": 3.0})
    tuned.reset(np.zeros(9))
    assert tuned.step(np.zeros(3), 0.5).knobs["process_noise"] == pytest.approx(3.0)
    with pytest.raises(ValueError, match="parameter of hmm-noise 'proces_noise'"):
        TunedFilter(BISTATIC, "hmm-noise", {"proces_noise": 3.0})


# ----- its state as a file ----------------------------------------------------------


@pytest.mark.parametrize("env_id, agent", [
    (VALIDATION, "hmm-noise"), (VALIDATION, "innovation-noise"), (VALIDATION, "vb-noise"),
    (VALIDATION, "policy"), (INERTIAL, "policy"), (GNSS, "satellite-hmm"), (GNSS, "raim"),
    (BISTATIC, "innovation-fading"), (BISTATIC, "nis-gate"), (BISTATIC, "huber-gate"),
])  # fmt: skip
@pytest.mark.parametrize("half", [0, 1, 13])
def test_a_track_goes_on_from_its_file(env_id, agent, half, tmp_path):
    kwargs = short(env_id)
    recording = draw(env_id, [1], **kwargs)
    if agent == "policy":
        agent = trained_on(tmp_path / "policy.npz", env_id, observation="full", **kwargs)
    one = begun(env_id, agent, recording, kwargs)
    feed(one, recording, 0, half)
    one.save(tmp_path / "track.npz")
    other = TunedFilter(env_id, agent, **kwargs)
    other.load(tmp_path / "track.npz")
    for mine, theirs in zip(
        feed(one, recording, half, 30), feed(other, recording, half, 30), strict=True
    ):
        for a, b in zip(mine[:4], theirs[:4], strict=True):
            np.testing.assert_array_equal(a, b)
        assert mine.knobs == theirs.knobs


def test_a_foreign_or_damaged_file_changes_nothing(tmp_path):
    recording = draw(BISTATIC, [1])
    one = begun(BISTATIC, "hmm-noise", recording, {})
    before = feed(one, recording, 0, 5)[-1]
    path = tmp_path / "track.npz"
    begun(BISTATIC, "pooled-noise", recording, {}).save(path)
    with pytest.raises(ValueError, match=r"state of pooled-noise .* and this is hmm-noise"):
        one.load(path)
    path.write_bytes(path.read_bytes()[:400])
    with pytest.raises(ValueError, match="no state of a TunedFilter, or is damaged"):
        one.load(path)
    with pytest.raises(FileNotFoundError):
        one.load(tmp_path / "nowhere.npz")
    np.testing.assert_array_equal(feed(one, recording, 5, 6)[-1].time, before.time + 0.1)


def test_a_state_that_is_no_array_is_told(tmp_path):
    tuned = begun(BISTATIC, "random", draw(BISTATIC, [1]), {})
    with pytest.raises(ValueError, match="holds rng, a Generator"):
        tuned.save(tmp_path / "track.npz")


# ----- at the door --------------------------------------------------------------------


@pytest.fixture
def tuned():
    filter = TunedFilter(BISTATIC, "hmm-noise")
    filter.reset(np.zeros(9))
    filter.step(np.zeros(3), 0.5)
    return filter


@pytest.mark.parametrize("arguments, complaint", [
    (([0.0, 0.0], 0.5), r"The measurement z has the shape \(2,\), and \(3,\)"),
    (([0.0, 0.0, np.inf], 0.5), "z holds infinity"),
    (([0.0, 0.0, 0.0], -0.1), "dt must lie between 0 and 1"),
    (([0.0, 0.0, 0.0], np.nan), "dt must lie"),
    (([0.0, 0.0, 0.0], 2.0), "steps in between whose z is NaN"),
    (([0.0, 0.0, 0.0], 0.5, [1.0]), r"The motion's inputs u has the shape \(1,\)"),
    (([0.0, 0.0, 0.0], 0.5, None, [1.0, np.nan, 1.0]), "The noise holds NaN"),
    (([0.0, 0.0, 0.0], 0.5, None, [1.0, 0.0, 1.0]), "not positive"),
    (([0.0, 0.0, 0.0], 0.5, None, None, [2.0]), r"sensor's inputs s has the shape \(1,\)"),
])  # fmt: skip
def test_what_does_not_fit_is_told_and_changes_nothing(tuned, arguments, complaint):
    with pytest.raises(ValueError, match=complaint) as error:
        tuned.step(*arguments)
    assert str(error.value).count(". ") == 0
    assert tuned.time == 0.0
    assert tuned.step(np.zeros(3), 0.5).time == 0.5


def test_missing_channels_are_skipped(tuned):
    before = tuned.step([0.0, np.nan, 0.0], 0.5)
    after = tuned.step([np.nan] * 3, 0.5)
    assert np.isfinite(before.nis) and np.isnan(after.nis)
    assert np.trace(after.covariance) > np.trace(before.covariance)


@pytest.mark.parametrize("mean, factor, complaint", [
    (np.zeros(8), None, r"The initial mean has the shape \(8,\)"),
    (np.full(9, np.nan), None, "The initial mean holds NaN"),
    (np.zeros(9), np.zeros(9), "positive standard deviations"),
    (np.zeros(9), np.ones((9, 9)), "np.linalg.cholesky"),
    (np.zeros(9), np.eye(3), r"The initial factor has the shape \(3, 3\)"),
])  # fmt: skip
def test_a_wrong_beginning_is_told(tuned, mean, factor, complaint):
    with pytest.raises(ValueError, match=complaint):
        tuned.reset(mean, factor)


def test_a_failure_says_when_and_why_and_stays_until_reset(tuned):
    for _ in range(2):
        with pytest.raises(RuntimeError, match=r"BistaticTracking failed at 0.5 s, since the"):
            tuned.step([1e300, 0.0, 0.0], 0.5)
    tuned.reset(np.zeros(9))
    assert np.isfinite(tuned.step(np.zeros(3), 0.5).estimate).all()


def test_it_does_not_begin_by_itself():
    with pytest.raises(RuntimeError, match="call reset"):
        TunedFilter(BISTATIC, "fixed").step(np.zeros(3), 0.5)


def test_the_noise_of_a_radar_must_be_told():
    tuned = TunedFilter(TRACKING, "fixed")
    tuned.reset(np.ones(9) * 1000.0)
    with pytest.raises(ValueError, match="is another at each measurement"):
        tuned.step([1700.0, 0.8, 0.6], 0.1)
    tuned = TunedFilter(TRACKING, "fixed", nominal_noise=[1.0, 0.01, 0.01])
    tuned.reset(np.ones(9) * 1000.0)
    assert np.isfinite(tuned.step([1700.0, 0.8, 0.6], 0.1).nis)


@pytest.mark.parametrize("name", ["clairvoyant", "imm", "ekf"])
def test_who_needs_a_whole_recording_is_refused(name):
    with pytest.raises(ValueError, match="needs a whole recording"):
        TunedFilter(BISTATIC, name)


def test_agents_that_do_not_suit_are_refused():
    with pytest.raises(ValueError, match="and BistaticTracking has none"):
        TunedFilter(BISTATIC, "raim")
    with pytest.raises(ValueError, match="comes with kfenv for Filter"):
        TunedFilter(OWN, "learned")


@pytest.mark.parametrize("name", [name for name in AGENTS if not AGENTS[name].clairvoyant])
def test_every_agent_that_decides_by_itself_runs(name):
    """Bistatic, or where satellites are asked for those."""
    env_id = GNSS if name in ("raim", "satellite-gate", "satellite-hmm") else BISTATIC
    kwargs = short(env_id, rate=2.0, duration=2.0)
    recording = draw(env_id, [0], **kwargs)
    for step in feed(begun(env_id, name, recording, kwargs), recording):
        assert np.isfinite(step.estimate).all()
