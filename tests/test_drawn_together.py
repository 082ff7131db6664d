"""Episodes drawn together have the bits of those drawn alone, whatever else is drawn beside."""

from dataclasses import dataclass, fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kfenv.models.constant_acceleration import constant_acceleration
from kfenv.scenarios import scenario as drawing
from kfenv.scenarios.faults import Glint, Jamming, SignalLoss
from kfenv.scenarios.gnss.tracking import GnssTracking
from kfenv.scenarios.inertial.ins_gnss import InsGnss
from kfenv.scenarios.own import OwnFilter
from kfenv.scenarios.radar.bistatic import BistaticTracking
from kfenv.scenarios.radar.tracking import RadarTracking
from kfenv.scenarios.radar.validation import RadarValidation
from kfenv.scenarios.recording import Recording
from kfenv.scenarios.trajectories import accelerated_flights, drawn_trajectory

SHORT = {
    "RadarTracking": RadarTracking(duration=30.0),
    "RadarTracking, few fit": RadarTracking(duration=400.0, rate=1.0),
    "RadarTracking, paper": RadarTracking(faults="paper", duration=100.0, rate=1.0),
    "RadarValidation": RadarValidation(duration=30.0, rate=2.0, faults="random"),
    "BistaticTracking": BistaticTracking(duration=20.0),
    "GnssTracking": GnssTracking(duration=30.0, ionosphere=0.5),
    "InsGnss": InsGnss(duration=10.0),
    "InsGnss, biases": InsGnss(duration=5.0, biases=True, imu_instability=(0.1, 0.1)),
    "Filter": OwnFilter(duration=5.0),
}


def generators(seeds):
    return [np.random.default_rng(seed) for seed in seeds]


def assert_same_as_alone(scenario, seeds):
    together, alone = generators(seeds), generators(seeds)
    drawn = scenario.sample(together)
    for i, rng in enumerate(alone):
        one, other = scenario.sample([rng]), drawn[[i]]
        for field in fields(Recording)[:-1]:
            a, b = getattr(one, field.name), getattr(other, field.name)
            assert (a is None and b is None) or a.tobytes() == b.tobytes(), field.name
        assert one.faults == other.faults
    states = [[rng.bit_generator.state for rng in rngs] for rngs in (together, alone)]
    assert states[0] == states[1]


@pytest.mark.parametrize("name", SHORT)
def test_together_as_alone(name):
    assert_same_as_alone(SHORT[name], range(5))


def test_parts_join(monkeypatch):
    monkeypatch.setattr(drawing, "LEAST_AT_ONCE", 2)
    monkeypatch.setattr(drawing, "AT_ONCE", 1)
    assert_same_as_alone(SHORT["RadarTracking"], range(5))


RADAR_FAULTS = {
    "rain": {"rate": [30.0, 60.0]}, "jamming": {"bursts": [0, 4]}, "signal_loss": {}, "glint": {},
    "noise_misreport": {}, "self_screening_jammer": {"start": 2.0, "known": False},
}  # fmt: skip


@settings(max_examples=15, deadline=None)
@given(
    seeds=st.lists(st.integers(0, 2**32 - 1), min_size=2, max_size=4),
    names=st.lists(st.sampled_from(sorted(RADAR_FAULTS)), unique=True),
    flights=st.sampled_from(["manoeuvring", "gentle", "smooth"]),
)
def test_any_seeds_and_faults(seeds, names, flights):
    faults = {name: RADAR_FAULTS[name] for name in names}
    scenario = RadarTracking(duration=12.0, rate=4.0, faults=faults, flights=flights)
    assert_same_as_alone(scenario, seeds)


class Replacing:
    """A fault that puts arrays of its own in place of the draft's."""

    label = "offset"

    def apply(self, draft, rng):
        draft.exact = draft.exact + rng.uniform(1.0, 2.0)
        draft.available = draft.available & (draft.time < 3.0)[:, None]


def test_a_fault_may_replace_the_arrays():
    offset, clean = (
        RadarTracking(duration=5.0, faults=faults).sample(generators([0, 1]))
        for faults in ([Replacing()], "none")
    )
    late = offset.time >= 3.0
    assert np.isnan(offset.measurement[:, late]).all()
    assert not np.array_equal(*(r.measurement[:, ~late, 0] for r in (offset, clean)))
    assert_same_as_alone(RadarTracking(duration=5.0, faults=[Replacing()]), [0, 1])


@dataclass(frozen=True)
class Longer(SignalLoss):
    """A fault derived from one that spoils many at once, with an `apply` of its own."""

    def apply(self, draft, rng):
        super().apply(draft, rng)
        draft.available[-3:] = False


class Spoiling(RadarTracking):
    """A scenario that spoils its episodes itself, one at a time."""

    def spoil(self, draft, rng):
        super().spoil(draft, rng)
        draft.noise_factor[draft.window("more", 1.0, rng.uniform(1.0, 2.0))] *= 3.0


def test_faults_of_one_episode_and_of_many_take_turns():
    faults = [Jamming(bursts=(2, 2)), Replacing(), Longer(), Glint(), Longer()]
    scenario = RadarTracking(duration=30.0, faults=faults)
    assert np.isnan(scenario.sample(generators(range(3))).measurement[:, -3:]).all()
    assert_same_as_alone(scenario, range(5))


def test_a_scenario_that_spoils_episodes_itself():
    scenario = Spoiling(duration=5.0, faults=[SignalLoss()])
    drawn = scenario.sample(generators(range(3)))
    assert [[label for label, *_ in one] for one in drawn.faults] == [["signal loss", "more"]] * 3
    assert_same_as_alone(scenario, range(3))


def test_a_scenario_that_draws_one_at_a_time_is_refused():
    with pytest.raises(TypeError, match=r"Mine defines trajectory, .* define trajectories\(rngs\)"):

        class Mine(RadarValidation):
            def trajectory(self, rng):
                return np.zeros((len(self.time), 9))


def test_accelerated_flights_are_those_of_the_step_by_step_simulation():
    motion, start = constant_acceleration(0.7), np.linspace(-40.0, 60.0, 9)
    time = np.arange(31) / 7.0
    together = accelerated_flights(generators(range(3)), motion, start, time)
    for flight, rng in zip(together, generators(range(3)), strict=True):
        assert flight.tobytes() == drawn_trajectory(rng, motion, start, time).tobytes()
