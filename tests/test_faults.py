"""Each fault does what it says, inside its labelled intervals and nowhere else."""

from dataclasses import dataclass

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils import seeding
from rollouts import (
    PECULIAR,
    TRACKING,
    VALIDATION,
    assert_same_recording,
    draw,
    every_environment,
    make,
    play,
    zeros,
)

from kfenv.models.namespaces import batch
from kfenv.models.phased_array import PhasedArray, rain_transmission
from kfenv.scenarios.faults import Draft, Glint, Jamming, NoiseMisreport, SignalLoss
from kfenv.scenarios.radar.scenario import Rain, SelfScreeningJammer
from kfenv.scenarios.trajectories import paper_trajectory

TIME = np.arange(1201) / 10.0


def spoilt(fault, seed=0, time=TIME) -> Draft:
    draft = Draft.clean(time, 3)
    fault.apply(draft, np.random.default_rng(seed))
    return draft


def inside(draft: Draft, label: str) -> np.ndarray:
    """Which instants lie in an interval of that label."""
    covered = np.zeros(len(draft.time), bool)
    for interval in draft.intervals:
        assert interval.label == label
        assert draft.time[0] <= interval.start <= interval.stop <= draft.time[-1]
        covered |= (draft.time >= interval.start) & (draft.time < interval.stop)
    return covered


def untouched(draft: Draft, *names: str) -> bool:
    clean = Draft.clean(draft.time, 3)
    return all((getattr(draft, name) == getattr(clean, name)).all() for name in names)


# ----- one by one -----------------------------------------------------------------------


def test_jamming_raises_the_noise_inside_its_bursts_only():
    counts, factors = [], []
    for seed in range(300):
        draft = spoilt(Jamming(), seed)
        during = inside(draft, "jamming")
        assert (draft.noise_factor[~during] == 1.0).all()
        assert (draft.noise_factor[during] > 2.0).all() and draft.noise_factor.max() <= 31.0
        assert (draft.noise_factor == draft.noise_factor[:, :1]).all()  # all channels alike
        assert untouched(draft, "told_factor", "available")
        lengths = [interval.stop - interval.start for interval in draft.intervals]
        assert all(5.0 <= length <= 25.0 for length in lengths)
        counts.append(len(lengths))
        factors.extend(np.unique(draft.noise_factor[during]))
    assert set(counts) == {1, 2, 3}
    assert np.median(factors) == pytest.approx(np.sqrt(2.0 * 31.0), rel=0.2)  # log-uniform


def test_jamming_takes_the_strongest_where_bursts_overlap():
    draft = spoilt(Jamming(bursts=(9, 9), duration=(60.0, 60.0), factor=(5.0, 5.0)))
    assert set(np.unique(draft.noise_factor.round(9))) == {1.0, 5.0}


def test_jamming_where_and_when_it_is_told():
    fault = Jamming(bursts=(1, 1), start=70.0, duration=(30.0, 30.0), factor=(4.0, 4.0))
    draft = spoilt(fault)
    during = (TIME >= 70.0) & (TIME < 100.0)
    assert (draft.noise_factor[during] == 4.0).all() and (draft.noise_factor[~during] == 1.0).all()
    assert draft.intervals == [("jamming", 70.0, 100.0)]


def test_signal_loss_takes_everything_away_inside_its_interval_only():
    for seed in range(50):
        draft = spoilt(SignalLoss(), seed)
        during = inside(draft, "signal loss")
        assert (~draft.available[during]).all() and draft.available[~during].all()
        assert len(draft.intervals) == 1 and 19 <= during.sum() <= 81  # 2 to 8 s at 10 Hz
        assert untouched(draft, "noise_factor", "told_factor")


def test_glint_strikes_whole_measurements_in_half_of_the_episodes():
    drafts = [spoilt(Glint(), seed) for seed in range(400)]
    hit = [draft for draft in drafts if draft.intervals]
    assert 160 < len(hit) < 240
    for draft in drafts:
        assert set(np.unique(draft.noise_factor)) == ({1.0, 8.0} if draft.intervals else {1.0})
        assert (draft.noise_factor == draft.noise_factor[:, :1]).all()
        assert untouched(draft, "told_factor", "available")
        assert all(interval == ("glint", 0.0, 120.0) for interval in draft.intervals)
    share = np.mean([draft.noise_factor == 8.0 for draft in hit])
    assert share == pytest.approx(0.1, abs=0.01)


def test_a_misreport_is_of_what_is_told_channel_by_channel():
    told = []
    for seed in range(200):
        draft = spoilt(NoiseMisreport(), seed)
        assert (draft.told_factor == draft.told_factor[0]).all()
        assert len(set(draft.told_factor[0])) == 3
        assert untouched(draft, "noise_factor", "available")
        assert draft.intervals == [("misreported noise", 0.0, 120.0)]
        told.append(draft.told_factor[0])
    assert 0.4 <= np.min(told) < 0.45 and 2.3 < np.max(told) <= 2.5
    assert np.median(told) == pytest.approx(1.0, rel=0.15)


def test_rain_weakens_the_echo_and_the_radar_knows():
    dry, wet = (draw(TRACKING, [0], duration=60.0, faults=faults)
                for faults in ([], [Rain(rate=(50.0, 50.0))]))  # fmt: skip
    scenario = make(TRACKING, duration=60.0, faults=[]).scenario
    draft = scenario.draft(wet.truth[0], np.random.default_rng(0))
    transmission = rain_transmission(draft.exact[:, 0], 50.0)
    np.testing.assert_array_equal(wet.truth[0], scenario.trajectory(seeding.np_random(0)[0]))
    np.testing.assert_array_equal(wet.true_noise, wet.noise)
    np.testing.assert_allclose(wet.noise[0], scenario.noise(draft, draft.snr * transmission))
    assert (wet.noise > scenario.noise(draft, draft.snr)).all()
    assert dry.faults == ((),) and wet.faults[0] == (("rain", 0.0, 60.0),)


@pytest.mark.parametrize("known", [True, False])
def test_the_self_screening_jammer_drowns_the_echo(known):
    fault = SelfScreeningJammer(start=5.0, duration=3.0, known=known)
    jammed, clear = (draw(TRACKING, [0], duration=12.0, faults=faults) for faults in ([fault], []))
    during = (jammed.time >= 5.0) & (jammed.time < 8.0)
    scenario = make(TRACKING, duration=12.0).scenario
    draft = scenario.draft(jammed.truth[0], np.random.default_rng(0))
    rise = 1.0 + PhasedArray().jammer_to_noise(draft.exact[:, 0], fault.power, fault.bandwidth)
    expected = scenario.noise(draft, draft.snr / rise)[during]
    np.testing.assert_allclose(jammed.true_noise[0, during], expected)
    assert (jammed.true_noise[0, during] > 2.0 * clear.true_noise[0, during]).all()
    np.testing.assert_array_equal(jammed.true_noise[0, ~during], clear.true_noise[0, ~during])
    told_as = jammed.true_noise if known else clear.true_noise
    np.testing.assert_array_equal(jammed.noise, told_as)
    assert jammed.faults[0] == (("jamming", 5.0, 8.0),)


def test_what_lies_beyond_the_episode_is_not_labelled():
    draft = spoilt(SignalLoss(start=150.0))
    assert draft.available.all() and draft.intervals == []
    draft = spoilt(SignalLoss(start=118.0, duration=(10.0, 10.0)))
    assert draft.intervals == [("signal loss", 118.0, 120.0)] and not draft.available[-1].any()


# ----- into the measurements ------------------------------------------------------------


@every_environment
def test_measurements_carry_the_true_noise_and_the_filter_is_told_its_own(env_id):
    faults = [
        Jamming(bursts=(1, 1), start=50.0, duration=(30.0, 30.0), factor=(3.0, 3.0)),
        SignalLoss(start=20.0, duration=(5.0, 5.0)),
        NoiseMisreport(factor=(2.0, 2.0)),
    ]
    recording = draw(env_id, range(4), duration=100.0, faults=faults)
    clean = draw(env_id, range(4), duration=100.0, faults="none")
    lost = (recording.time >= 20.0) & (recording.time < 25.0)
    jammed = (recording.time >= 50.0) & (recording.time < 80.0)
    arrived = np.isfinite(clean.measurement)
    arrived[:, lost] = False
    np.testing.assert_array_equal(np.isfinite(recording.measurement), arrived)
    np.testing.assert_allclose(recording.noise, 2.0 * clean.noise)
    np.testing.assert_allclose(recording.true_noise[:, jammed], 3.0 * clean.noise[:, jammed])
    np.testing.assert_allclose(recording.true_noise[:, ~jammed], clean.noise[:, ~jammed])
    sensor = make(env_id).scenario.sensor
    state, inputs = (tuple(np.moveaxis(array, -1, 0))
                     for array in (recording.truth, recording.sensor_inputs))  # fmt: skip
    off = recording.measurement - np.stack(sensor.build(batch)(state, inputs), axis=-1)
    angles = [i for i, channel in enumerate(sensor.channels) if channel.angle]
    off[..., angles] = np.angle(np.exp(1j * off[..., angles]))
    normal = off / recording.true_noise
    for instants in (jammed, ~jammed & ~lost):
        for group in range(len(sensor.groups)):
            values = normal[:, instants][..., np.array(sensor.group_of_channel) == group]
            assert np.nanstd(values) == pytest.approx(1.0, abs=0.06)
            assert np.nanmean(values) == pytest.approx(0.0, abs=0.1)


# ----- ways to name them ----------------------------------------------------------------


@every_environment
def test_objects_and_a_mapping_say_the_same(env_id):
    objects = [Jamming(start=1.0, duration=(2.0, 2.0)), Glint(probability=1.0)]
    mapping = {"jamming": {"start": 1.0, "duration": [2.0, 2.0]}, "glint": {"probability": 1.0}}
    one = draw(env_id, range(3), faults=objects)
    assert_same_recording(one, draw(env_id, range(3), faults=mapping))
    assert {label for label, *_ in one.faults[0]} == {"jamming", "glint"}


@every_environment
def test_presets(env_id):
    assert draw(env_id, [0], faults="none").faults == ((),)
    drawn = draw(env_id, range(20), duration=120.0, faults="random")
    labels = {label for intervals in drawn.faults for label, *_ in intervals}
    scenario = gym.make(env_id).unwrapped.scenario
    assert labels == {fault.label for fault in scenario.presets["random"]}
    assert labels >= {"jamming", "misreported noise"}
    assert ("rain" in labels) == (env_id == TRACKING)
    assert scenario.faults == PECULIAR[env_id].default_faults


def test_the_papers_case_is_flown_whole():
    env = gym.make(TRACKING, faults="paper").unwrapped
    recording = env.scenario.sample([np.random.default_rng(0)])
    assert recording.faults == ((("jamming", 70.0, 100.0), ("signal loss", 150.0, 160.0)),)
    np.testing.assert_array_equal(recording.truth[0], paper_trajectory("B", recording.time))
    np.testing.assert_array_equal(recording.noise, recording.true_noise)  # R(t) from S/N
    lost = (recording.time >= 150.0) & (recording.time < 160.0)
    np.testing.assert_array_equal(np.isnan(recording.measurement[0]).all(axis=1), lost)
    assert recording.time[-1] == 250.0


@pytest.mark.parametrize(("rate", "deviation"), [(10.0, (20, 1.45, 1.45)), (2.0, (30, 1.45, 5.0))])
def test_the_published_validation_noise(rate, deviation):
    recording = draw(VALIDATION, [0], rate=rate, duration=250.0, faults="paper")
    expected = np.array(deviation) * [1.0, np.pi / 180.0, np.pi / 180.0]
    np.testing.assert_allclose(recording.noise, np.broadcast_to(expected, recording.noise.shape))
    np.testing.assert_array_equal(recording.truth[0], paper_trajectory("A", recording.time))


@dataclass(frozen=True)
class Blinking:
    """A user's own fault: every second measurement is missing."""

    label: str = "blinking"

    def apply(self, draft, rng):
        draft.available[1::2] = False
        draft.throughout(self.label)


@every_environment
def test_a_fault_of_ones_own_works_through_gym_make(env_id):
    env = make(env_id, faults=[Blinking(), NoiseMisreport()])
    heard = play(env, zeros(env, 41), seed=0)
    assert heard[-1][3]
    pending = [np.isfinite(step[-1]["innovation_variance"]).any() for step in heard[:-1]]
    clear = np.isfinite(draw(env_id, [0], faults="none").measurement[0]).any(axis=1)
    assert clear.sum() >= 4 and pending == [clear[k] and k % 2 == 0 for k in range(41)]
    labels = env.unwrapped.scenario.sample([np.random.default_rng(0)]).faults[0]
    assert [label for label, *_ in labels] == ["blinking", "misreported noise"]
