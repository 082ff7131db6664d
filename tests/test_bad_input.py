"""Bad input gets one clear sentence that names the culprit, at the door."""

import dataclasses
import re

import gymnasium as gym
import numpy as np
import pytest
from rollouts import (
    GNSS,
    OWN,
    TRACKING,
    VALIDATION,
    change,
    draw,
    every_environment,
    make,
    make_vec,
    zeros,
)

from kfenv.names import unknown
from kfenv.scenarios.faults import Glint, Jamming, NoiseMisreport, SignalLoss
from kfenv.scenarios.radar.scenario import Rain, SelfScreeningJammer
from kfenv.scenarios.recording import Recording, stack

NAN, INFINITE = float("nan"), float("inf")


def complaint(kind, call, *args, **keywords) -> str:
    """What is said; a wrapper of Gymnasium adds its own words after ours."""
    with pytest.raises(kind) as caught:
        call(*args, **keywords)
    said = str(caught.value).split(" was raised from the environment creator")[0]
    length = len(re.sub(r"\S*/", "", said))  # wherever the files are
    assert 20 < length < 330 and "\n" not in said and said[-1] in ".?", said
    return said


WRONG = [  # keyword argument of every environment, what must be said of it
    ({"durationn": 5}, "'durationn'. Did you mean 'duration'"),
    ({"duration": 0}, "duration"),
    ({"duration": -3.0}, "-3.0"),
    ({"duration": NAN}, "nan"),
    ({"duration": "long"}, "'long'"),
    ({"duration": 1e9}, "an episode has at most"),
    ({"rate": 0.5}, "rate must lie between 1 and 100"),
    ({"rate": 1000.0}, "1000.0"),
    ({"rate": "10"}, "rate"),
    ({"rate": True}, "rate"),
    ({"reward": "rms"}, "'rms'. Did you mean 'rmse'"),
    ({"reward": None}, "None"),
    ({"observation": "ful"}, "'ful'. Did you mean 'full'"),
    ({"observation": None}, "None"),
    ({"actions": ["fadin"]}, "'fadin'. Did you mean 'fading'"),
    ({"actions": "noise"}, "'noise'"),
    ({"actions": []}, "no knob"),
    ({"actions": 3}, "3"),
    ({"most_fading": 1.0}, "most_fading must be a number above 1"),
    ({"most_fading": "10"}, "most_fading"),
    ({"filter": "srukf-jospeh"}, "srukf-joseph"),
    ({"filter": "ukf-joseph"}, "'ukf-joseph' carries a covariance"),
    ({"filter": "ckf"}, "name it as an agent of `kfenv evaluate`"),
    ({"filter": None}, "None"),
    ({"kappa": -1.0}, "kappa must be a non-negative number, got -1.0"),
    ({"kappa": NAN}, "kappa"),
    ({"kappa": "1"}, "'1'"),
    ({"decision_interval": 0}, "decision_interval"),
    ({"decision_interval": 2**70}, "decision_interval must be a whole number"),
    ({"filter": "none"}, "Unknown filter design 'none'"),
    ({"decision_interval": 1.5}, "1.5"),
    ({"recording": np.zeros((1, 4, 3))}, "ndarray"),
    ({"faults": "randm"}, "'randm'. Did you mean 'random'"),
    ({"faults": None}, "None"),
    ({"faults": Jamming()}, "list of fault objects"),
    ({"faults": [Jamming]}, "Jamming"),
    ({"faults": ["jamming"]}, "'jamming' is no fault"),
    ({"faults": {"jaming": {}}}, "'jaming'. Did you mean 'jamming'"),
    ({"faults": {"jamming": {"strt": 1}}}, "'strt'. Did you mean 'start'"),
    ({"faults": {"jamming": None}}, "None"),
    ({"faults": {"jamming": {"factor": [-1.0, 2.0]}}}, "Jamming.factor"),
    ({"faults": {"glint": {"fraction": 1.5}}}, "Glint.fraction"),
]


def test_of_many_known_names_the_most_alike_are_told():
    said = unknown("fruit", "aple", ["pear", "apple"])
    assert said == "Unknown fruit 'aple'. Did you mean 'apple'? Known: pear, apple."
    said = unknown("fruit", "aple", ["apple", *(f"cherry-{i}" for i in range(40))])
    assert "Did you mean 'apple'? Known: apple, cherry" in said and len(said) < 250
    assert said.count("cherry") == 11 and said.endswith(" and 29 others.")


@pytest.mark.parametrize(("env_id", "log"), [(GNSS, "plots"), (TRACKING, "rinex"), (OWN, "log")])
def test_a_log_of_another_kind_says_whom_it_is_for(env_id, log):
    assert f"takes no {log}: " in complaint(TypeError, gym.make, env_id, **{log: "file"})


@every_environment
@pytest.mark.parametrize(("keywords", "culprit"), WRONG, ids=lambda value: str(value)[:40])
def test_keyword_arguments(env_id, keywords, culprit):
    if env_id == OWN and keywords in ({"rate": 0.5}, {"rate": 1000.0}):
        pytest.skip("a model of one's own may have any rate")
    kind = TypeError if "durationn" in keywords else ValueError
    for maker in (gym.make, lambda *a, **k: gym.make_vec(*a, num_envs=2, **k)):
        assert culprit in complaint(kind, maker, env_id, **keywords)


@pytest.mark.parametrize(
    "deviation",
    [(0.0, 1.0, 1.0), (20.0, -1.0, 1.0), (20.0, 1.0), (), 20.0, (20.0, NAN, 1.0), (1, "a", 2)],
)
def test_zero_negative_or_misshapen_noise(deviation):
    said = complaint(ValueError, gym.make, VALIDATION, noise_deviation=deviation)
    assert "noise_deviation must hold three positive numbers" in said and str(deviation) in said


def test_what_only_one_scenario_refuses():
    for env_id in (TRACKING, VALIDATION):
        said = complaint(ValueError, gym.make, env_id, radar_position=(0.0, 0.0, 0.0))
        assert "give a track too" in said
    assert "published for 5 Hz" in complaint(ValueError, gym.make, VALIDATION, rate=5.0)
    assert "600 s" in complaint(ValueError, gym.make, TRACKING, duration=601.0)
    assert "'noise_deviation'" in complaint(TypeError, gym.make, TRACKING, noise_deviation=1)
    assert "'rain'" in complaint(ValueError, gym.make, VALIDATION, faults={"rain": {}})
    for fault in (Rain(), SelfScreeningJammer()):
        assert "radar equation" in complaint(ValueError, gym.make, VALIDATION, faults=[fault])


@pytest.mark.parametrize(
    ("fault", "field", "value"),
    [
        (fault, field, value)
        for fault, field in [
            (Jamming, "duration"), (Jamming, "factor"), (SignalLoss, "duration"),
            (NoiseMisreport, "factor"),
        ]
        for value in [(0.0, 1.0), (-1.0, 1.0), (2.0, 1.0), 3.0, (1.0,), (1.0, NAN),
                      (1.0, INFINITE), ("a", "b"), None]
    ]
    + [(Jamming, "bursts", value) for value in [(-1, 2), (2, 1), (1.5, 2.5), 2]]
    + [(Jamming, "start", value) for value in [-1.0, NAN, "noon"]]
    + [(SignalLoss, "start", -1.0), (SelfScreeningJammer, "start", None)]
    + [(SelfScreeningJammer, "duration", value) for value in [0.0, -3.0, NAN, "a"]]
    + [(SelfScreeningJammer, "power", value) for value in [-1.0, NAN, INFINITE, "a"]]
    + [(SelfScreeningJammer, "bandwidth", value) for value in [0.0, -3.0, NAN, "a"]]
    + [(Rain, "rate", value) for value in [(-1.0, 2.0), (0.0, INFINITE), 50.0]]
    + [(Glint, "factor", value) for value in [0.0, -8.0, NAN, INFINITE, "8"]]
    + [(Glint, name, v) for name in ("probability", "fraction") for v in (-0.1, 1.1, NAN, "a")],
)  # fmt: skip
def test_ranges_of_faults(fault, field, value):
    said = complaint(ValueError, fault, **{field: value})
    assert fault.__name__ in said and field in said and repr(value) in said


@every_environment
def test_a_fault_that_makes_noise_negative_is_found(env_id):
    class Silence:
        label = "silence"

        def apply(self, draft, rng):
            draft.noise_factor[3] = 0.0

    env = make(env_id, faults=[Silence()])
    assert "Recording.true_noise must be positive" in complaint(ValueError, env.reset, seed=0)


# ----- actions, seeds, order of calls ---------------------------------------------------


@every_environment
def test_actions(env_id):
    env, vector = make(env_id), make_vec(env_id, 2)
    env.reset(seed=0), vector.reset(seed=0)
    (knobs,) = env.action_space.shape
    said = complaint(ValueError, env.step, np.zeros(knobs - 1))
    assert f"({knobs - 1},)" in said and f"({knobs},)" in said
    assert "shape ()" in complaint(ValueError, env.step, 0.0)
    assert f"({knobs},)" in complaint(ValueError, vector.step, np.zeros(knobs))
    for environment in (env, vector):
        action = zeros(environment)
        action.flat[-1] = NAN
        assert "NaN" in complaint(ValueError, environment.step, action)
        environment.step(zeros(environment))  # unharmed


@every_environment
@pytest.mark.parametrize("mode", ["next_step", "same_step", "disabled"])
def test_step_before_reset(env_id, mode):
    env, vector = make(env_id), make_vec(env_id, 3, autoreset_mode=mode)
    assert "reset()" in complaint(RuntimeError, env.step, zeros(env))
    said = complaint(RuntimeError, vector.step, zeros(vector))
    assert "3 sub-environments" in said and "reset()" in said
    vector.reset(options={"reset_mask": np.array([True, False, True])})
    assert "1 sub-environments" in complaint(RuntimeError, vector.step, zeros(vector))


@every_environment
def test_step_after_the_end(env_id):
    env, vector = make(env_id, duration=0.2), make_vec(env_id, 2, duration=0.2,
                                                       autoreset_mode="disabled")  # fmt: skip
    env.reset(seed=0), vector.reset(seed=0)
    for _ in range(3):
        env.step(zeros(env)), vector.step(zeros(vector))
    assert "reset()" in complaint(RuntimeError, env.step, zeros(env))
    assert "reset_mask" in complaint(RuntimeError, vector.step, zeros(vector))


@every_environment
def test_vector_arguments(env_id):
    say = complaint(ValueError, gym.make_vec, env_id, num_envs=2, autoreset_mode="next")
    assert "'next'. Did you mean 'next_step'" in say
    for number in (0, -1, 1.5, True):
        assert str(number) in complaint(ValueError, gym.make_vec, env_id, num_envs=number)
    say = complaint(ValueError, gym.make_vec, env_id, num_envs=2, render_mode="rgb_array")
    assert "gym.make" in say
    vector = make_vec(env_id, 2)
    assert "3 seeds" in complaint(ValueError, vector.reset, seed=[1, 2, 3])
    for mask in (np.zeros(2, bool), np.ones(3, bool), np.ones(2)):
        said = complaint(ValueError, vector.reset, options={"reset_mask": mask})
        assert "reset_mask" in said


@every_environment
def test_render_mode(env_id):
    with pytest.warns(UserWarning, match="rgb"):  # Gymnasium's, before ours
        assert "'rgb'" in complaint(ValueError, gym.make, env_id, render_mode="rgb")


# ----- recordings -----------------------------------------------------------------------


def nan_in(array):
    array.flat[4] = NAN


def repeat(array):
    array[3] = array[2]


def upper(array):
    array[:, 0, 1] = 1.0


SPOILT = [
    ("truth", nan_in, "NaN"),
    ("noise", nan_in, "NaN"),
    ("true_noise", nan_in, "NaN"),
    ("true_bias", nan_in, "NaN"),
    ("mean", nan_in, "NaN"),
    ("time", nan_in, "time"),
    ("time", repeat, "duplicate"),
    ("noise", lambda a: a.fill(0.0), "positive"),
    ("noise", lambda a: np.negative(a, out=a), "positive"),
    ("measurement", lambda a: a.fill(INFINITE), "infinity"),
    ("factor", upper, "lower triangular"),
    ("factor", lambda a: np.negative(a, out=a), "positive diagonal"),
]
MISSHAPEN = [
    ("truth", (2, 40, 9)), ("noise", (2, 41, 2)), ("mean", (1, 9)), ("factor", (2, 9)),
    ("time", (40,)), ("motion_inputs", (2, 41)), ("measurement", (41, 3)), ("true_noise", (1,)),
    ("true_bias", (2, 41, 2)),
]  # fmt: skip


@pytest.mark.parametrize(("name", "spoil", "reason"), SPOILT)
def test_values_of_a_recording(name, spoil, reason):
    said = complaint(ValueError, change, draw(TRACKING, range(2)), **{name: spoil})
    assert f"Recording.{name}" in said and reason in said


@pytest.mark.parametrize(("name", "shape"), MISSHAPEN)
def test_shapes_of_a_recording(name, shape):
    said = complaint(ValueError, change, draw(TRACKING, range(2)), **{name: np.ones(shape)})
    assert name in said and str(shape) in said


@every_environment
def test_a_recording_of_another_scenario(env_id):
    recording = draw(env_id, [0])
    fewer = dataclasses.replace(recording, measurement=recording.measurement[..., :-1],
                                noise=recording.noise[..., :-1], true_noise=None,
                                true_bias=None)  # fmt: skip
    channels = recording.measurement.shape[2] - 1
    assert f"{channels} channels" in complaint(ValueError, gym.make, env_id, recording=fewer)
    inputs = recording.motion_inputs.shape[2] + 2
    more = change(recording, motion_inputs=np.zeros((1, len(recording.time), inputs)))
    assert f"{inputs} motion inputs" in complaint(ValueError, gym.make, env_id, recording=more)


def test_recordings_that_cannot_be_stacked():
    one, other = draw(TRACKING, [0]), draw(TRACKING, [0], duration=5.0)
    assert "different times" in complaint(ValueError, stack, [one, other])
    assert "at least one" in complaint(ValueError, stack, [])
    untold = change(one, truth=None)
    for pair in ([one, untold], [untold, one]):
        assert "truth" in complaint(ValueError, stack, pair)


def test_the_arrays_given_to_a_recording_stay_ones_own():
    recording = draw(TRACKING, [0])
    mine = recording.measurement.copy()
    theirs = change(recording, measurement=mine)
    assert mine.flags.writeable and not theirs.measurement.flags.writeable
    assert isinstance(theirs, Recording)
