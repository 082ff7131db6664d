"""The same seed gives the same bits: again, inside a vector environment, and after pickling."""

import pickle
from copy import deepcopy
from itertools import cycle, islice

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import load_env_creator
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from rollouts import (
    PECULIAR,
    assert_same,
    change,
    draw,
    error_name,
    every_environment,
    make,
    make_vec,
    play,
    random_actions,
    short,
    zeros,
)

SETTINGS = {
    "defaults": {},
    "two per second": {"rate": 2.0, "duration": 6.0},
    "held actions": {"decision_interval": 3},
    "improvement": {"reward": "improvement", "decision_interval": 2},
    "log": {"reward": "log-rmse", "decision_interval": 2},
    "some knobs": {"actions": ["process_noise", "measurement_noise"]},
    "another filter": {"filter": "srukf-joseph-prior", "duration": 1.0},
}
every_setting = pytest.mark.parametrize("setting", SETTINGS)
COPIES = (deepcopy, lambda env: pickle.loads(pickle.dumps(env)))
every_mode = pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.name)
# Every mode with the defaults, and every other setting with one of them in turn.
modes_and_settings = pytest.mark.parametrize(
    ("mode", "setting"),
    [(mode, "defaults") for mode in AutoresetMode]
    + list(zip(cycle(AutoresetMode), list(SETTINGS)[1:], strict=False)),
    ids=lambda value: getattr(value, "name", value),
)


@pytest.fixture(autouse=True)
def tracks_are_lost_early(monkeypatch):
    """Episodes then end at different times, some terminated and some truncated."""
    for env_id, peculiar in PECULIAR.items():
        environment = load_env_creator(gym.spec(env_id).entry_point)
        monkeypatch.setattr(environment.scenario_class, "lost_distance", peculiar.early_loss)


@every_environment
@every_setting
def test_same_seed_same_bits(env_id, setting):
    one, other = make(env_id, **SETTINGS[setting]), make(env_id, **SETTINGS[setting])
    actions = random_actions(one.action_space.shape, 60)
    first = play(one, actions, seed=3)
    assert_same(first, play(other, actions, seed=3))
    play(one, actions)  # an episode between
    assert_same(first, play(one, actions, seed=3))
    assert not np.array_equal(first[0][0], play(one, actions, seed=4)[0][0])


@every_environment
@modes_and_settings
def test_vector_equals_gymnasiums_own_over_single_ones(env_id, setting, mode):
    keywords = SETTINGS[setting]
    ours = make_vec(env_id, 5, autoreset_mode=mode, **keywords)
    theirs = SyncVectorEnv([lambda: make(env_id, **keywords)] * 5, autoreset_mode=mode)
    assert ours.metadata["autoreset_mode"] == theirs.metadata["autoreset_mode"] == mode
    mine, reference = ours.reset(seed=7), theirs.reset(seed=7)
    np.testing.assert_array_equal(mine[0], reference[0])
    assert_same_info(mine[1], reference[1])
    terminations = truncations = 0
    for actions in random_actions(ours.action_space.shape, 50):
        mine, reference = ours.step(actions), theirs.step(actions)
        for a, b in zip(mine[:4], reference[:4], strict=True):
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b)
        assert_same_info(mine[4], reference[4])
        terminations, truncations = terminations + mine[2].sum(), truncations + mine[3].sum()
        over = mine[2] | mine[3]
        if mode == AutoresetMode.DISABLED and over.any():
            mine = ours.reset(options={"reset_mask": over.copy()})
            reference = theirs.reset(options={"reset_mask": over.copy()})
            np.testing.assert_array_equal(mine[0], reference[0])
            assert_same_info(mine[1], reference[1])
    assert terminations and truncations


def assert_same_info(ours: dict, theirs: dict) -> None:
    """Equal masks, and equal values where the masks say that there are any."""
    for key in {name.removeprefix("_") for name in ours.keys() | theirs.keys()}:
        mask = ours[f"_{key}"]
        if key not in theirs:  # Gymnasium leaves out what no sub-environment told
            assert not mask.any(), key
            continue
        np.testing.assert_array_equal(mask, theirs[f"_{key}"], err_msg=key)
        if isinstance(theirs[key], dict):
            assert_same_info(ours[key], theirs[key])
        elif key == "final_obs":
            for a, b in zip(ours[key], theirs[key], strict=True):
                np.testing.assert_array_equal(a, b)
        else:
            np.testing.assert_array_equal(ours[key][mask], theirs[key][mask], err_msg=key)


@every_environment
@every_setting
def test_sub_environment_equals_the_single_one_seeded_alike(env_id, setting):
    vector = make_vec(env_id, 4, **SETTINGS[setting])
    actions = random_actions(vector.action_space.shape, 60)
    heard = [vector.reset(seed=20), *(vector.step(a) for a in actions)]
    for i in range(4):
        single = play(make(env_id, **SETTINGS[setting]), [a[i] for a in actions], seed=20 + i)
        assert len(single) > 1
        for (observation, *rest), (batch, *batch_rest) in zip(single, heard, strict=False):
            np.testing.assert_array_equal(observation, batch[i])
            for value, values in zip(rest[:-1], batch_rest[:-1], strict=True):
                assert value == values[i]
            for key in ("time", "estimate", error_name(env_id), "nis", "nees", "innovation"):
                np.testing.assert_array_equal(rest[-1][key], batch_rest[-1][key][i], key)


@every_environment
def test_a_list_of_seeds_and_a_mask_reach_their_sub_environments(env_id):
    vector = make_vec(env_id, 3)
    observation, _ = vector.reset(seed=[8, 2, 5])
    for i, seed in enumerate((8, 2, 5)):
        np.testing.assert_array_equal(observation[i], make(env_id).reset(seed=seed)[0])
    assert vector.np_random_seed == (8, 2, 5)
    vector.step(np.ones(vector.action_space.shape))
    before = vector.step(np.ones(vector.action_space.shape))[0]
    mask = np.array([False, True, False])
    observation, info = vector.reset(seed=[None, 9, None], options={"reset_mask": mask})
    np.testing.assert_array_equal(observation[1], make(env_id).reset(seed=9)[0])
    np.testing.assert_array_equal(observation[[0, 2]], before[[0, 2]])
    np.testing.assert_array_equal(info["_time"], mask)


@every_environment
@pytest.mark.parametrize(("setting", "copy"), list(zip(SETTINGS, cycle(COPIES), strict=False)))
def test_a_copy_goes_on_like_the_original(env_id, setting, copy):
    original = gym.make(env_id, **short(env_id, **SETTINGS[setting]))
    first, second, *actions = random_actions(original.action_space.shape, 60)
    for seed in range(1, 100):  # up to an episode that is not lost at once
        original.reset(seed=seed)
        if not (original.step(first)[2] or original.step(second)[2]):
            break
    twin = copy(original)
    for action in actions:
        heard = original.step(action)
        assert_same(heard, twin.step(action))
        if heard[2] or heard[3]:  # the copied generator draws the next episode
            assert_same(original.reset(), twin.reset())


@every_environment
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_a_copied_vector_goes_on_like_the_original(env_id, mode):
    original = make_vec(env_id, 6, autoreset_mode=mode)
    actions = iter(random_actions(original.action_space.shape, 60))
    original.reset(seed=1)
    for action in islice(actions, 15):
        original.step(action)
    twin = pickle.loads(pickle.dumps(original))
    for action in actions:
        heard, echo = original.step(action), twin.step(action)
        assert_same(heard[:4], echo[:4])
        assert_same_info(heard[4], echo[4])


@every_environment
def test_a_seed_starts_a_replay_again(env_id):
    recording = draw(env_id, range(4))
    env = make(env_id, recording=recording)
    first = env.reset(seed=0)[0]
    second = env.reset()[0]
    assert not np.array_equal(first, second)
    np.testing.assert_array_equal(env.reset(seed=0)[0], first)
    vector = make_vec(env_id, 2, recording=recording)
    np.testing.assert_array_equal(vector.reset(seed=0)[0], [first, second])
    others = vector.reset()[0]
    np.testing.assert_array_equal(others[0], make(env_id, recording=recording[[2]]).reset()[0])
    np.testing.assert_array_equal(vector.reset(seed=1)[0], [first, second])


@every_environment
def test_a_failed_filter_tells_the_same_nothing_every_time(env_id):
    """What the engine leaves unwritten must not be handed out."""

    def spoil(measurement):
        measurement[0, 1] = 1e300

    recording = change(draw(env_id, [0], faults="none"), measurement=spoil)
    env = make(env_id, recording=recording)
    actions = zeros(env, 9)
    first = play(env, actions)
    assert first[-1][2] and len(first) in (3, 4)
    assert np.isnan(first[-1][4]["estimate"]).all() and np.isnan(first[-1][4]["nis"])
    assert not first[-1][0].any()
    assert_same(first, play(make(env_id, recording=recording), actions))
