"""The film draws what happens, quickly, without a screen, and touches nothing else."""

import subprocess
import sys
from dataclasses import replace
from itertools import pairwise

import gymnasium as gym
import numpy as np
import pytest
from rollouts import every_environment, short, zeros

from kfenv.envs.history import merged
from kfenv.envs.panels import ellipse
from kfenv.envs.radar import RadarTrackingEnv
from kfenv.models.model import Component, Sensor
from kfenv.models.namespaces import batch
from kfenv.models.position import position
from kfenv.models.radar import radar
from kfenv.scenarios.measured import measured_positions
from kfenv.scenarios.recording import FaultInterval

ACTION = np.array([0.1, 0.2, -0.1, 0.3, 0.0])
SHORT = {"duration": 8.0, "rate": 1.0}


@pytest.fixture
def make():
    made = []

    def build(mode="rgb_array", **keywords):
        made.append(RadarTrackingEnv(mode, **(SHORT | keywords)))
        return made[-1]

    yield build
    for env in made:
        env.close()


def one_episode(seed=3, **keywords):
    scenario = RadarTrackingEnv(**(SHORT | keywords)).scenario
    return scenario.sample([np.random.default_rng(seed)])


def test_a_frame_is_an_image_that_changes_with_every_step(make):
    env = make()
    env.reset(seed=1)
    frames = [env.render()]
    for _ in range(3):
        env.step(ACTION)
        frames.append(env.render())
    assert all(frame.dtype == np.uint8 and frame.shape == (900, 1200, 3) for frame in frames)
    changed = [(before != after).sum() for before, after in pairwise(frames)]
    assert min(changed) > 100


@every_environment
def test_every_environment_is_drawn(env_id):
    """To the end of an episode with every fault; measured positions lie about the true ones."""
    env = gym.make(env_id, render_mode="rgb_array", **short(env_id)).unwrapped
    env.reset(seed=1)
    first = env.render()
    over = False
    while not over:
        _, _, lost, ended, _ = env.step(zeros(env))
        over = lost or ended
    assert env.render().shape == first.shape == (900, 1200, 3)
    assert (env.render() != first).sum() > 1000
    seen = env._film._history.seen
    if len(seen):
        off = np.linalg.norm(seen - env._film._history.truth, axis=1)
        assert np.nanmedian(off) < 20.0 * env.scenario.error_scale
    env.close()


def test_the_kept_background_changes_nothing(make):
    env = make()
    env.reset(seed=1)
    for _ in range(5):
        env.step(ACTION)
        quick = env.render()
    env._film._background = None
    np.testing.assert_array_equal(env.render(), quick)


def test_a_rendered_episode_has_the_same_bits(make):
    plain, drawn = make(None), make()
    first = [env.reset(seed=5)[0] for env in (plain, drawn)]
    np.testing.assert_array_equal(*first)
    over = False
    while not over:
        (a, reward, *ends, _), (b, other_reward, *other_ends, _) = (
            env.step(ACTION) for env in (plain, drawn)
        )
        drawn.render()
        np.testing.assert_array_equal(a, b)
        assert (reward, ends) == (other_reward, other_ends)
        over = any(ends)


def test_each_episode_begins_an_empty_film(make):
    env = make(recording=one_episode())
    env.reset()
    begin = env.render()
    env.step(ACTION)
    env.render()
    env.reset()
    np.testing.assert_array_equal(env.render(), begin)


def test_a_log_without_truth_is_drawn(make):
    env = make(recording=replace(one_episode(), truth=None))
    env.reset()
    before = env.render()
    for _ in range(4):
        env.step(ACTION)
    assert (env.render() != before).any()


def test_a_sensor_that_measures_no_position_is_drawn_without_dots(make, monkeypatch):
    monkeypatch.setattr("kfenv.envs.history.measured_positions", lambda *_: None)
    env = make(recording=replace(one_episode(), truth=None), actions="range_noise")
    env.reset()
    for _ in range(8):  # long enough to leave the first view
        env.step(np.zeros(1))
        assert env.render() is not None


def test_a_lost_track_is_drawn_to_its_end(make):
    recording = one_episode()
    wild = np.array(recording.mean)
    wild[0, 0] += 15_000.0
    env = make(recording=replace(recording, mean=wild, measurement=recording.measurement * np.nan))
    env.reset()
    assert env.step(ACTION)[2]
    assert env.render().shape == (900, 1200, 3)


def test_save_writes_the_picture_and_the_film_goes_on(make, tmp_path):
    env = make()
    env.reset(seed=1)
    env.step(ACTION)
    before = env.render()
    env._film.save(tmp_path / "episode.png")
    assert (tmp_path / "episode.png").stat().st_size > 10_000
    np.testing.assert_array_equal(env.render(), before)


def test_render_before_reset_says_what_to_do(make):
    with pytest.raises(RuntimeError, match="call reset"):
        make().render()


def test_closing_twice_is_fine_and_rendering_may_go_on(make):
    env = make()
    env.reset(seed=1)
    env.render()
    env.close()
    env.close()
    assert env.render() is not None


def test_human_mode_without_windows_says_so_and_runs(make):
    pytest.importorskip("matplotlib").use("agg")
    with pytest.warns(UserWarning, match="opens no window"):
        env = make("human")
    env.reset(seed=1)
    env.step(ACTION)
    assert env.render() is None


def test_matplotlib_is_imported_for_drawing_only_and_pyplot_never():
    code = (
        "import sys, kfenv.envs.radar, kfenv.envs.rendering\n"
        "assert 'matplotlib' not in sys.modules\n"
        "env = kfenv.envs.radar.RadarTrackingEnv('rgb_array', duration=2.0)\n"
        "env.reset(seed=1); env.render()\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_measured_positions_invert_the_radar():
    recording = one_episode(faults="none")
    place = [0, 3, 6]
    truth = recording.truth[0][:, place]
    exact = np.stack(radar().build(batch)(tuple(recording.truth[0].T), ()), axis=1)
    np.testing.assert_allclose(measured_positions(radar(), exact), truth, atol=1e-6)
    np.testing.assert_array_equal(measured_positions(position(), truth), truth)
    other = Sensor("other", (Component("pseudorange", "m", "pseudorange"),), None)
    assert measured_positions(other, exact[:, :1]) is None


def test_merged_joins_overlapping_faults_of_one_kind_only():
    faults = [
        FaultInterval("jamming", 5.0, 9.0),
        FaultInterval("signal loss", 4.0, 6.0),
        FaultInterval("jamming", 8.0, 12.0),
        FaultInterval("jamming", 20.0, 21.0),
    ]
    assert merged(faults) == (
        FaultInterval("signal loss", 4.0, 6.0),
        FaultInterval("jamming", 5.0, 12.0),
        FaultInterval("jamming", 20.0, 21.0),
    )


def test_the_ellipse_holds_95_percent():
    rng = np.random.default_rng(0)
    root = np.array([[3.0, 0.0, 0.0], [2.0, 1.0, 0.0], [0.5, 0.1, 1.0]])
    outline = ellipse(root @ root.T)
    norm = np.linalg.norm(np.linalg.solve(root[:2, :2], outline), axis=0)
    np.testing.assert_allclose(norm, norm[0])  # an ellipse of this covariance
    errors = np.linalg.norm(rng.standard_normal((100_000, 2)), axis=1)
    assert abs(np.mean(errors < norm[0]) - 0.95) < 0.003
