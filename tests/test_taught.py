"""Taught agents: lessons and gradients through the filter do what they say, and runs repeat."""

import json
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch")

import pendulum
import torch
from kfenv.agents.contest.rollout import SPLITS, draw_episodes, rollout, scenario_and_options
from kfenv.agents.contest.suites import SUITES
from kfenv.agents.contestants.channelwise import ChannelwiseNetwork
from kfenv.agents.contestants.policy import NumpyPolicy
from kfenv.agents.contestants.registry import make_agent
from kfenv.agents.learning.networks import RecurrentNetwork
from kfenv.agents.learning.runs import TrainingInterrupted
from kfenv.agents.learning.teaching import refinement, training
from kfenv.agents.learning.teaching.course import Curriculum
from kfenv.agents.learning.teaching.rolling import roll
from kfenv.agents.learning.teaching.through_filter import Chunk, Refinery, chunks, no_lane_rules
from kfenv.agents.learning.teaching.training import teach
from kfenv.agents.learning.teaching.worlds import TRAINING, build_world, bundled_worlds
from rollouts import GNSS, OWN

from kfenv.models.own import own_motion

ENV = "kfenv/RadarTracking-v0"
KWARGS = {"rate": 2.0, "duration": 20.0}
FULL = KWARGS | {"observation": "full"}
WORLDS = {
    "radar-2hz": "radar", "bistatic": "bistatic", "radar-validation": "radar-validation",
    "gnss": "gnss", "ins-gnss": "ins-gnss",
}  # fmt: skip
TINY = {
    "episodes": 12, "epochs": 1, "rounds": 2, "units": 8, "refined_episodes": 6, "chunk": 15,
    "tuning_trials": 0, "checkpoint_every": 2,
}  # fmt: skip
LESSONS = Curriculum(updates=5)


def _network(part, seed=0):
    torch.manual_seed(seed)
    core = roll_core(part)
    low, high = np.full(len(core.knobs), -1.0), np.full(len(core.knobs), 1.0)
    size = core.observation_size
    return RecurrentNetwork(np.zeros(size), np.ones(size), low, high, 8)


def roll_core(part):
    from kfenv.envs.core import Core

    return Core(part.scenario, part.options, 1, part.scenario.time, has_truth=True)


@pytest.fixture(scope="module")
def part():
    return build_world(ENV, FULL, None)[0]


@pytest.fixture(scope="module")
def calm():
    """Without faults no episode runs away, so that small changes stay small."""
    return build_world(ENV, FULL | {"faults": "none"}, None)[0]


@pytest.fixture(scope="module")
def rolled(calm):
    part = calm
    network, recording = _network(part), part.draw(0, 0, 8)
    return network, roll(network, part, recording, keep=range(41))


def _refinery(part, consistency=0.0):
    largest = 200.0 / part.scenario.error_scale
    return Refinery(part.scenario, part.options.kappa, consistency, largest)


def test_through_the_filter_runs_what_the_environment_ran(calm, rolled):
    network, told = rolled
    refinery = _refinery(calm)
    logs, _ = network(torch.from_numpy(told.observations), network.start(8))
    factors = refinery._factors(told, logs.double())
    errors, _, counts = refinery._run(told, 0, factors)
    kept = told.running.all(axis=0)
    assert kept.sum() > 4
    mean = (errors.mean(dim=0)).detach().numpy()
    assert counts[:, kept].min() == 1.0
    np.testing.assert_allclose(mean[kept], told.squared_error[kept], rtol=1e-4)


def test_the_knob_of_a_single_state_is_turned_once():
    states = pendulum.ANGLE, replace(pendulum.RATE, group="drive")
    motion = own_motion(states, pendulum.swing, Q=(0.0, 1e-3))
    kwargs = pendulum.MODEL | pendulum.WORLD | {"duration": 1.0, "motion": motion}
    part = build_world(OWN, kwargs | {"observation": "full"}, None)[0]
    network = _network(part)
    told = roll(network, part, part.draw(0, 0, 4), keep=(0, 8))
    logs, _ = network(torch.from_numpy(told.observations), network.start(4))
    refinery = _refinery(part)
    factors = refinery._factors(told, logs.double())
    assert factors.shape[2] == 5 and (factors[:, :, 3] != 1.0).all()
    whole, rest = refinery._run(told, 0, factors)[0], refinery._run(told, 8, factors[8:])[0]
    torch.testing.assert_close(rest, whole[8:], rtol=1e-4, atol=0.0)


@pytest.mark.parametrize("consistency", [0.0, 0.5])
def test_gradient_through_the_filter_is_that_of_finite_differences(calm, rolled, consistency):
    network, told = rolled
    refinery, chunk = _refinery(calm, consistency), Chunk(told, 5, 20)
    bias = network.head.bias
    network.zero_grad()
    refinery.loss(network, chunk).backward()
    gradient = bias.grad.clone()
    for k in range(len(bias)):
        values = []
        for side in (1e-2, -1e-2):
            with torch.no_grad():
                bias[k] += side
                values.append(_without_detached(refinery, network, chunk, consistency))
                bias[k] -= side
        slope = (values[0] - values[1]) / 2e-2
        assert abs(slope - gradient[k].item()) < 2e-2 * abs(slope) + 1e-4


def _without_detached(refinery, network, chunk, consistency):
    """The loss; the consistency term holds the error fixed, so its own slope is left alone."""
    if not consistency:
        return refinery.loss(network, chunk).item()
    told, fixed = chunk.roll, _refinery_errors
    original = refinery._nees
    refinery._nees = lambda off, *state: original(next(fixed.replay), *state)
    fixed.replay = iter(fixed.errors(refinery, told, chunk))
    try:
        return refinery.loss(network, chunk).item()
    finally:
        refinery._nees = original


class _Errors:
    """The errors of the unperturbed network, which the consistency term takes as given."""

    def __init__(self):
        self.kept = None

    def errors(self, refinery, told, chunk):
        return self.kept


_refinery_errors = _Errors()


@pytest.fixture(autouse=True)
def _unperturbed(request):
    if "rolled" not in request.fixturenames:
        return
    part, (network, told) = (request.getfixturevalue(name) for name in ("calm", "rolled"))
    refinery, kept = _refinery(part, 0.5), []
    original = refinery._nees

    def keep(off, *state):
        kept.append(off)
        return original(off, *state)

    refinery._nees = keep
    with torch.no_grad():
        refinery.loss(network, Chunk(told, 5, 20))
    _refinery_errors.kept = kept


def test_chunks_tile_the_episode():
    assert chunks(41, 15, 4) == [(0, 4), (4, 19), (19, 34), (34, 41)]
    assert chunks(10, 15, 10) == [(0, 10)]


def test_labels_are_the_teachers_and_missing_channels_do_not_count(part):
    recording = part.draw(0, 0, 8)
    rng = np.random.default_rng(0)
    teacher = make_agent("clairvoyant")
    told = roll(_network(part), part, recording, teacher=teacher, jitter=(rng, 0.3))
    ratio = np.minimum(recording.true_noise / recording.noise, 500.0)  # where the knob ends
    true = np.log(ratio).swapaxes(0, 1)
    for k, knob in enumerate(told.core.knobs[2:]):
        channel = [c.name for c in part.scenario.sensor.channels].index(knob.name[:-6])
        valid = told.valid[:, :, 2 + k]
        missing = np.isnan(recording.measurement[:, :, channel]).T
        assert not (valid & missing[: len(valid)]).any()
        np.testing.assert_allclose(
            told.labels[:, :, 2 + k][valid], true[: len(valid), :, channel][valid], atol=1e-5
        )


def test_a_policy_as_teacher_gives_its_own_actions(tmp_path):
    teach(ENV, LESSONS, seed=0, output=tmp_path / "large", env_kwargs=KWARGS,
          progress=False, **TINY)  # fmt: skip
    path = str(tmp_path / "large")
    small = teach(
        ENV, Curriculum(teacher=path, updates=0), seed=1, output=tmp_path / "small",
        env_kwargs=KWARGS, progress=False, **(TINY | {"units": 4}),
    )  # fmt: skip
    policy = NumpyPolicy.load(small)
    assert policy.start(1).shape == (1, 4)
    recording = draw_episodes(ENV, KWARGS, "validation", 0, 4)
    assert np.isfinite(rollout(make_agent(str(small)), ENV, KWARGS, recording).rmse).all()


def test_runs_repeat_and_resume(tmp_path, monkeypatch):
    def run(name, **more):
        return teach(ENV, LESSONS, seed=3, output=tmp_path / name, env_kwargs=KWARGS,
                     progress=False, **TINY, **more)  # fmt: skip

    def network(path):
        return NumpyPolicy.load(path).network

    one, two = network(run("one")), network(run("two"))
    for a, b in zip(one.parameters, two.parameters, strict=True):
        np.testing.assert_array_equal(a, b)

    class Stop:
        asked = 0

        def is_set(self):
            Stop.asked += 1
            return Stop.asked > 9

    from contextlib import contextmanager

    @contextmanager
    def stopping():
        yield Stop()

    with monkeypatch.context() as patch, pytest.raises(TrainingInterrupted, match="--resume"):
        patch.setattr(training, "stop_as_event", stopping)
        run("three")
    record = json.loads((tmp_path / "three" / "training.json").read_text())
    assert not record["finished"] and record["updates"] < 5
    run("three", resume=True)
    record = json.loads((tmp_path / "three" / "training.json").read_text())
    assert record["finished"] and record["updates"] == 5 and record["rounds"] == 2


def test_a_budget_in_minutes_becomes_a_number_of_updates(tmp_path, monkeypatch):
    monkeypatch.setattr(refinement, "TIMED", 2)
    teach(ENV, Curriculum(teacher=None, minutes=1e-4), seed=0, output=tmp_path / "a",
          env_kwargs=KWARGS, progress=False, **TINY)  # fmt: skip
    record = json.loads((tmp_path / "a" / "training.json").read_text())
    assert record["total"] is not None and record["updates"] >= 2


def test_a_network_for_all_satellites_is_taught_refined_and_resumed(tmp_path):
    kwargs, tiny = {"duration": 12.0}, TINY | {"episodes": 4, "refined_episodes": 3, "chunk": 4}
    course = Curriculum(teacher="clairvoyant-channels", updates=2)
    for folder, plan in (("whole", course), ("more", replace(course, updates=1))):
        path = teach(GNSS, plan, seed=0, output=tmp_path / folder, env_kwargs=kwargs,
                     progress=False, **tiny)  # fmt: skip
    assert isinstance(NumpyPolicy.load(path).network, ChannelwiseNetwork)
    recording = draw_episodes(GNSS, kwargs, "validation", 0, 2)
    scores = [rollout(make_agent(str(tmp_path / f)), GNSS, kwargs, recording)
              for f in ("whole", "more")]  # fmt: skip
    assert np.isfinite(scores[0].rmse).all() and (scores[0].rmse != scores[1].rmse).any()
    again = teach(GNSS, Curriculum(init=str(path), updates=1), seed=1, output=tmp_path / "on",
                  env_kwargs=kwargs, progress=False, **tiny)  # fmt: skip
    assert NumpyPolicy.load(again).digest != NumpyPolicy.load(path).digest


def test_a_model_of_ones_own_is_taught_refined_and_known_again(tmp_path):
    kwargs = pendulum.MODEL | pendulum.WORLD | {"duration": 2.0}
    told = {"seed": 0, "output": tmp_path / "run", "env_kwargs": kwargs, "progress": False} | TINY
    path = teach(OWN, Curriculum(updates=2), **told)
    assert teach(OWN, Curriculum(updates=2), resume=True, **told) == path
    recording = draw_episodes(OWN, kwargs, "validation", 0, 2)
    scores = rollout(make_agent(str(path)), OWN, kwargs, recording)
    assert np.isfinite(scores.rmse).all() and (scores.rmse < 1.0).all()
    with pytest.raises(ValueError, match=r"env_kwargs\.scale was 0\.05 and is now 0\.1"):
        changed = told | {"env_kwargs": kwargs | {"scale": 0.1}}
        teach(OWN, Curriculum(updates=2), resume=True, **changed)


@pytest.mark.parametrize("suite, world", WORLDS.items())
def test_worlds_are_wider_than_their_suite_but_hold_none_of_its_other_cases(suite, world):
    suite = SUITES[suite]
    parts = build_world(suite.env_id, dict(suite.kwargs), world)
    kinds = [kind for part in parts for kind in part.kinds]
    assert len(kinds) > 1
    for case in suite.others.values():
        tested, _ = scenario_and_options(suite.env_id, dict(suite.kwargs) | dict(case.kwargs))
        assert tested not in [kind.scenario for kind in kinds]


def test_every_bundled_world_is_tested():
    assert set(bundled_worlds()) == set(WORLDS.values())


def test_training_draws_nothing_that_is_tested(tmp_path):
    assert TRAINING not in SPLITS.values()
    one, two = build_world(ENV, FULL, "radar")[0].kinds[:2]
    drawn = [one.draw(0, lesson, 2) for lesson in (0, 1)] + [two.draw(0, 0, 2)]
    drawn += [draw_episodes(ENV, FULL, split, 0, 2) for split in SPLITS]
    measured = {recording.measurement.tobytes() for recording in drawn}
    assert len(measured) == len(drawn)
    path = tmp_path / "mine.toml"
    path.write_text("[[part]]\nshare = 1.0\n[part.kwargs]\nfaults = 'none'\n")
    assert build_world(ENV, FULL, str(path))[0].scenario.faults == "none"


def test_a_part_draws_its_kinds_by_their_shares():
    part = build_world(ENV, FULL, "radar")[0]
    drawn, total = part.draw(0, 3, 40), part.share
    counts = [round(40 * kind.share / total) for kind in part.kinds]
    assert len(drawn) == 40
    first = part.kinds[0].draw(0, 3, counts[0])
    np.testing.assert_array_equal(drawn.measurement[: counts[0]], first.measurement)


def test_one_gradient_does_not_drown_the_others():
    gradient = torch.ones(2, 5, 1)
    gradient[:, 1] = 1e9
    gradient[:, 2] = torch.nan
    shortened = no_lane_rules(gradient)
    assert (shortened[:, [0, 3, 4]] == 1.0).all() and (shortened[:, 2] == 0.0).all()
    assert shortened[:, 1].max() < 6.0


@pytest.mark.parametrize(
    "text", ["", "[[part]]\nshare = 0\n", "[[part]]\nshare = 1\nkwarg = 1\n", "[[part]\n"]
)
def test_malformed_worlds_are_refused(text, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"mine\.toml"):
        build_world(ENV, FULL, str(path))


def test_bad_arguments_are_refused(tmp_path):
    def run(curriculum=LESSONS, **settings):
        teach(ENV, curriculum, seed=0, output=tmp_path / "x", env_kwargs=KWARGS,
              progress=False, **settings)  # fmt: skip

    with pytest.raises(ValueError, match="Unknown world"):
        run(Curriculum(world="moon"))
    with pytest.raises(ValueError, match="cannot teach"):
        run(Curriculum(teacher="imm-rq"))
    with pytest.raises(ValueError, match="units"):
        run(units=0)
    assert not (tmp_path / "x").exists()
