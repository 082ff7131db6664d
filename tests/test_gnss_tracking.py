"""The GNSS scenario: channels, faults, precision at the earth's radius, the published case."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pymap3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rollouts import GNSS, draw, make

from kfenv.filters.engine import Engine
from kfenv.filters.matrices import tria
from kfenv.filters.protocol import Knobs
from kfenv.filters.reference import ReferenceFilter
from kfenv.models.gnss.atmosphere import niell
from kfenv.models.gnss.orbits import look_angles
from kfenv.models.gnss.pseudorange import CHANNELS, as_printed
from kfenv.scenarios.faults import Draft
from kfenv.scenarios.gnss.faults import (
    ClockDegradation,
    MultipathBurst,
    PllFailure,
    RangeRamp,
    RangeStep,
    ReceiverMisreport,
)
from kfenv.scenarios.gnss.satellite_channels import assign_channels
from kfenv.scenarios.gnss.tracking import GnssTracking
from kfenv.scenarios.trajectories import paper_trajectory

ALMANAC = Path(__file__).parents[1] / "../shared/data/almanac/gps-week0862-319488.yuma"
POSITION = [0, 3, 6]


def sampled(seeds=range(4), **keywords):
    scenario = GnssTracking(**({"faults": "none", "duration": 60.0} | keywords))
    return scenario, scenario.sample([np.random.default_rng(seed) for seed in seeds])


def filtered(scenario, recording):
    run = Engine(scenario.motion, scenario.sensor).run(recording)
    assert not run.status.any()
    return run.mean


def shift(one, other):
    """What differs between the measurements of two recordings of the same seeds."""
    return (one.measurement - other.measurement)[0]


# ----- channels -------------------------------------------------------------------------


@given(arrays(bool, (30, 20), elements=st.booleans()))
@settings(max_examples=100, deadline=None)
def test_a_satellite_keeps_its_channel_while_it_is_visible(visible):
    elevation = np.broadcast_to(np.arange(20.0), visible.shape)
    channel = assign_channels(visible, elevation)
    for epoch, (seen, now) in enumerate(zip(visible, channel, strict=True)):
        held = now[now >= 0]
        assert seen[held].all() and len(set(held)) == len(held) == min(seen.sum(), CHANNELS)
        before = channel[epoch - 1] if epoch else np.full(CHANNELS, -1)
        stays = (before >= 0) & seen[before]
        np.testing.assert_array_equal(now[stays], before[stays])
        newcomers = np.setdiff1d(held, before)
        left_out = np.setdiff1d(np.flatnonzero(seen), held)
        if len(newcomers) and len(left_out):
            assert newcomers.min() > left_out.max()  # the highest come first


def test_every_measurement_is_of_a_satellite_above_the_mask():
    scenario, recording = sampled(duration=600.0, mask=15.0)
    assert scenario.dimensions == (0, 72)
    arrived = np.isfinite(recording.measurement)
    np.testing.assert_array_equal(arrived[..., :CHANNELS], arrived[..., CHANNELS:])
    assert arrived[:, ::10].any(axis=2).all() and not arrived[:, np.arange(6001) % 10 != 0].any()
    b, t, c = np.nonzero(arrived[..., :CHANNELS])
    satellite = recording.sensor_inputs.reshape(*recording.truth.shape[:2], CHANNELS, 2, 3)
    satellite, truth = satellite[b, t, c], recording.truth[b, t]
    line = satellite[:, 0] - truth[:, POSITION]
    up = truth[:, POSITION] / np.linalg.norm(truth[:, POSITION], axis=1, keepdims=True)
    distance = np.linalg.norm(line, axis=1)
    assert (np.degrees(np.arcsin(np.sum(line * up, axis=1) / distance)) > 14.6).all()  # geocentric
    assert (distance > 2.0e7).all() and (distance < 2.6e7).all()
    speed = np.sum(line * (satellite[:, 1] - truth[:, [1, 4, 7]]), axis=1) / distance
    off = recording.measurement[b, t, c] - distance - truth[:, 9]
    rate_off = recording.measurement[b, t, CHANNELS + c] - speed - truth[:, 10]
    assert np.std(off / recording.noise[b, t, c]) == pytest.approx(1.0, abs=0.04)
    assert np.std(rate_off / 0.06) == pytest.approx(1.0, abs=0.04)
    changes = (np.diff(arrived[:, ::10, :CHANNELS].astype(int), axis=1) != 0).any(axis=(1, 2))
    assert changes.any()  # satellites rise and set in these episodes


def test_rising_and_setting_do_not_disturb():
    """Estimates do not depend on which channels the satellites are in."""
    scenario, recording = sampled(duration=300.0)
    rng, steps = np.random.default_rng(0), len(recording.time)
    order = rng.permuted(np.tile(np.arange(CHANNELS), (steps, 1)), axis=1)
    both = np.hstack([order, CHANNELS + order])
    inputs = recording.sensor_inputs.reshape(4, steps, CHANNELS, 6)
    shuffled = replace(
        recording,
        measurement=np.take_along_axis(recording.measurement, both[None], axis=2),
        noise=np.take_along_axis(recording.noise, both[None], axis=2),
        sensor_inputs=np.take_along_axis(inputs, order[None, :, :, None], axis=2).reshape(
            4, steps, -1
        ),
    )
    off = filtered(scenario, recording) - filtered(scenario, shuffled)
    assert np.abs(off).max() < 1e-6


# ----- precision ------------------------------------------------------------------------


def with_visible(recording, counts):
    """The recording with so many satellites left in each episode; a full initial factor."""
    measurement = recording.measurement.copy()
    for b, count in enumerate(counts):
        measurement[b, :, count:CHANNELS] = measurement[b, :, CHANNELS + count :] = np.nan
    rng, (batch, n) = np.random.default_rng(1), recording.mean.shape
    deviation = np.diagonal(recording.factor, axis1=1, axis2=2)
    mixing = 0.5 * rng.normal(size=(batch, n, n)) + np.eye(n)
    return replace(recording, measurement=measurement, factor=tria(deviation[..., None] * mixing))


@pytest.fixture(scope="module")
def crowded(tmp_path_factory):
    """Twelve satellites in view: the baseline and its copy half a day later, as an almanac."""
    from kfenv.models.gnss.almanac import baseline_constellation

    scenario = GnssTracking(faults="none", duration=20.0, date="2016-02-29T05:00", mask=0.0)
    satellites = baseline_constellation()
    twice = type(satellites)(
        *(np.concatenate([getattr(satellites, name)] * 2) for name in satellites.__dict__)
    )
    twice.mean_anomaly[24:] += 0.3
    object.__setattr__(scenario, "_constellation", twice)
    return scenario, scenario.sample([np.random.default_rng(seed) for seed in range(5)])


def test_engine_and_reference_agree_with_any_number_of_satellites(crowded):
    scenario, recording = crowded
    assert np.isfinite(recording.measurement[:, ::10]).all()
    recording = with_visible(recording, counts := (0, 3, 6, 12, 12))
    recording.measurement.flags.writeable = True
    gaps = np.random.default_rng(2).random(recording.measurement[4].shape) < 0.4
    recording.measurement[4][gaps] = np.nan  # ranges and rates by themselves
    knobs = Knobs(np.full(len(counts), 1.01), np.full(len(counts), 1.3))
    fast = Engine(scenario.motion, scenario.sensor).run(recording, knobs)
    plain = ReferenceFilter(scenario.motion, scenario.sensor).history(recording, knobs)
    assert not fast.status.any() and not plain.status.any()
    deviation = np.sqrt(np.diagonal(plain.covariance, axis1=2, axis2=3))
    off = np.abs(fast.mean - plain.mean)
    # A range of 2e7 m is known to 4e-9 m, which is 1e-9 of its noise and more with bad geometry.
    assert (off < 1e-8 * deviation).all()
    np.testing.assert_allclose(fast.nis, plain.nis, rtol=1e-6, atol=1e-6)
    heard = np.isfinite(recording.measurement[:, ::10, :CHANNELS]).sum(axis=2)
    np.testing.assert_array_equal(heard[:4], np.broadcast_to(np.array(counts[:4])[:, None],
                                                             heard[:4].shape))  # fmt: skip


def test_the_earths_radius_costs_no_digits(crowded):
    """The same filter about an origin nearby: sums of squares are centred (SPEC F15)."""
    scenario, recording = crowded
    origin = np.round(recording.truth[0, 0, POSITION])
    mean, inputs = recording.mean.copy(), recording.sensor_inputs.copy()
    mean[:, POSITION] -= origin
    satellite = inputs.reshape(*inputs.shape[:2], CHANNELS, 6)
    satellite[..., :3] -= origin
    near = filtered(scenario, replace(recording, mean=mean, sensor_inputs=inputs))
    near[..., POSITION] += origin
    assert np.abs(near - filtered(scenario, recording)).max() < 1e-7


# ----- episodes -------------------------------------------------------------------------


def test_flights_are_placed_on_the_earth():
    scenario, recording = sampled(faults="paper", duration=250.0, place=(-33.0, 151.0, 200.0))
    local = paper_trajectory("B", recording.time)
    expected = pymap3d.enu2ecef(*local[:, ::3].T, -33.0, 151.0, 200.0)
    np.testing.assert_allclose(recording.truth[0, :, POSITION], expected, atol=1e-6)
    slope = np.gradient(recording.truth[0, :, 0], recording.time)
    np.testing.assert_allclose(recording.truth[0, 1:-1, 1], slope[1:-1], atol=0.05)
    origin, rotation = scenario.local_frame(recording.truth[0, 0, POSITION])
    moved = (recording.truth[0, :, POSITION].T - origin) @ rotation.T
    np.testing.assert_allclose(moved, local[:, ::3] - local[0, ::3], atol=25.0)  # another tangent
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)


def test_the_clock_of_the_truth_is_the_filters():
    _, recording = sampled(range(200), duration=30.0)
    bias, drift = recording.truth[..., 9], recording.truth[..., 10]
    assert np.std(bias[:, 0]) == pytest.approx(149.9, rel=0.2)
    grown = drift - drift[:, :1]
    assert np.var(grown[:, -1]) == pytest.approx(0.1 * 30.0, rel=0.4)
    apart = bias - bias[:, :1] - drift[:, :1] * recording.time
    assert np.var(apart[:, -1]) == pytest.approx(0.1 * 30.0**3 / 3.0, rel=0.4)


def test_the_time_of_day_is_drawn_unless_told():
    def first_satellite(**keywords):
        return sampled(**keywords)[1].sensor_inputs[:, 0, :3]

    fixed = first_satellite(date="2016-02-29T05:00", place=(0.0, 0.0, 0.0))
    assert np.linalg.norm(fixed - fixed[0], axis=1).max() < 10.0  # but for the flight time
    drawn = first_satellite()
    assert np.linalg.norm(drawn[1:] - drawn[0], axis=1).min() > 1e5


@pytest.mark.skipif(not ALMANAC.exists(), reason="no almanac in ../shared/data")
def test_an_almanac_of_ones_own():
    _, recording = sampled(almanac=str(ALMANAC), mask=5.0)
    visible = np.isfinite(recording.measurement[:, ::10, :CHANNELS]).sum(axis=2)
    assert 7 <= visible.min() and visible.max() <= 12


def test_what_the_corrections_leave():
    """Half of the ionosphere is metres, growing towards the horizon; the wet delay millimetres."""
    clean, left = sampled()[1], sampled(ionosphere=0.5)[1]
    delay = (left.measurement - clean.measurement)[:, ::10]
    assert np.nanmin(delay[..., :CHANNELS]) > 0.5 * 5e-9 * 299792458.0 * 0.99
    assert np.nanmax(delay[..., :CHANNELS]) < 0.5 * 40.0
    assert np.nanmax(np.abs(delay[..., CHANNELS:])) == 0.0


def test_the_whole_troposphere_is_in_the_loop():
    """Dry and wet zenith delay by Niell's mapping, 2.3 m and 0.1 m at sea level (S0 eq 53)."""
    keywords = {"faults": "paper", "duration": 100.0}
    left = sampled([0], **keywords)[1]
    whole = sampled([0], troposphere=1.0, **keywords)[1]
    delay = (whole.measurement - left.measurement)[0, ::10, :CHANNELS]
    assert np.isfinite(delay).sum() == 6 * 101
    satellite = left.sensor_inputs[0, ::10].reshape(-1, CHANNELS, 2, 3)[:, :, 0]
    receiver = left.truth[0, ::10, POSITION].T
    for channel in np.flatnonzero(np.isfinite(delay[0])):
        latitude, longitude, height = pymap3d.ecef2geodetic(*receiver.T)
        elevation = pymap3d.ecef2aer(*satellite[:, channel].T, latitude, longitude, height)[1]
        dry, wet = niell(np.radians(elevation), np.radians(latitude), height, 60)
        expected = 2.3 * np.exp(-0.116e-3 * height) * dry + 0.1 * wet
        np.testing.assert_allclose(delay[:, channel], expected, atol=1e-7)
    assert 2.0 < np.nanmin(delay) and 7.0 < np.nanmax(delay) < 14.0


def test_the_standard_correction_leaves_the_wet_delays_walk():
    """1 cm^2 in an hour overhead, and the same for all satellites but for their mapping."""
    scenario, recording = sampled([0], faults="paper", duration=100.0)
    exact = scenario.clean(Draft, recording.truth[0], None, recording.sensor_inputs[0]).exact
    seen = np.isfinite(recording.measurement[0, 1000, :CHANNELS])
    left = np.array([
        (scenario.draft(recording.truth[0], np.random.default_rng(seed)).exact - exact)[1000, :12]
        for seed in range(200)
    ])[:, seen]  # fmt: skip
    overhead = recording.sensor_inputs[0, 1000].reshape(CHANNELS, 2, 3)[seen, 0]
    sines = np.sin(look_angles(recording.truth[0, 1000, POSITION], overhead)[0])
    walks = left * sines
    assert np.std(walks) == pytest.approx(np.sqrt(1e-4 / 3600.0 * 101.0), rel=0.2)
    np.testing.assert_allclose(walks, np.tile(walks[:, :1], seen.sum()), rtol=0.02, atol=1e-6)


@pytest.mark.parametrize(("keywords", "complaint"), [
    ({"place": (100.0, 0.0, 0.0)}, "place must be"), ({"place": "Turin"}, "place must be"),
    ({"date": "yesterday"}, "date must be"), ({"date": "1979-01-01"}, "since 1980"),
    ({"date": 20160229}, "date must be"), ({"mask": 90.0}, "mask must be"),
    ({"measurement_rate": 3.0}, "must divide rate = 10"), ({"measurement_rate": 20.0}, "divide"),
    ({"measurement_rate": "1"}, "divide"), ({"measurement_rate": 0}, "must divide rate = 10"),
    ({"measurement_rate": -1.0}, "divide"), ({"measurement_rate": 5e-324}, "divide"),
    ({"date": "2016-W09-1"}, "date must be"), ({"date": "20160229"}, "date must be"),
    ({"date": "20160229T0500"}, "date must be"), ({"date": "2016-02-30"}, "date must be"),
    ({"date": "2016-02-29T05:00+01:00"}, "date must be"), ({"almanac": 5}, "almanac must be the"),
    ({"place": (0.0, 400.0, 0.0)}, "place must be"), ({"place": (0.0, 0.0, 1e6)}, "place must be"),
    ({"ionosphere": 2.0}, "ionosphere must be"), ({"troposphere": None}, "troposphere must be"),
    ({"duration": 700.0}, "at most 600"), ({"faults": {"range_jump": {}}}, "range_step"),
    ({"faults": [RangeStep]}, "RangeStep"),
])  # fmt: skip
def test_arguments_are_checked(keywords, complaint):
    with pytest.raises(ValueError, match=complaint):
        GnssTracking(**keywords)


# ----- faults ---------------------------------------------------------------------------

DURING = slice(200, 401, 10)  # of the instants at which something is measured


def spoilt(fault, seed=0, **keywords):
    """The change of the measurements (T, 24) that a fault from 20 to 40.05 s makes."""
    _, clean = sampled([seed], **keywords)
    _, recording = sampled([seed], faults=[fault], **keywords)
    return shift(recording, clean), recording, clean


def test_a_degraded_clock_errs_alike_for_all_satellites():
    fault = ClockDegradation(start=20.0, duration=(20.05, 20.05), range_error=(150.0, 150.0))
    errors = []
    for seed in range(10):
        change, recording, clean = spoilt(fault, seed)
        np.testing.assert_array_equal(recording.true_noise, clean.true_noise)
        # the rest of the episode draws on, so compare within an instant
        inside = change[DURING]
        for part in (inside[:, :CHANNELS], inside[:, CHANNELS:]):
            spread = np.nanmax(part, axis=1) - np.nanmin(part, axis=1)
            assert np.median(np.abs(np.nanmean(part, axis=1)) / spread) > 1.0
        errors.append(np.nanmean(inside[:, :CHANNELS], axis=1))
        outside = np.delete(change[::10], np.arange(20, 41), axis=0)
        assert np.nanmax(np.abs(outside)) < 30.0
    assert np.std(errors) == pytest.approx(150.0, rel=0.2)


def test_a_pll_failure_takes_all_satellites():
    _, recording, clean = spoilt(PllFailure(start=20.0, duration=(20.05, 20.05)))
    assert np.isnan(recording.measurement[0, DURING]).all()
    gone = np.isnan(recording.measurement[0]) & np.isfinite(clean.measurement[0])
    assert gone.any(axis=1).sum() == 21
    assert recording.faults[0][0].label == "PLL failure"


def exact_change(fault, seed=0, **keywords):
    """The change of the draft itself, without noise, and the draft."""
    scenario, recording = sampled([seed], **keywords)
    clean, draft = (scenario.draft(recording.truth[0], np.random.default_rng(5)) for _ in range(2))
    fault.apply(draft, np.random.default_rng(seed))
    return draft.exact - clean.exact, draft


def test_a_range_step_moves_one_satellite():
    signs = set()
    for seed in range(8):
        fault = RangeStep(start=20.0, duration=(20.05, 20.05), size=(50.0, 50.0))
        change, draft = exact_change(fault, seed)
        moved = np.argwhere(change[DURING] != 0.0)
        assert len(set(moved[:, 1])) == 1 and moved[0, 1] < CHANNELS and len(moved) == 21
        assert (draft.satellite[DURING, moved[0, 1]] == draft.satellite[200, moved[0, 1]]).all()
        assert np.count_nonzero(change) == 21
        np.testing.assert_allclose(np.abs(change[change != 0.0]), 50.0, atol=1e-7)
        signs.add(np.sign(change[200, moved[0, 1]]))
        assert (draft.noise_factor == 1.0).all() and draft.available[DURING].any()
    assert signs == {-1.0, 1.0}


def test_a_range_ramp_keeps_range_and_rate_in_agreement():
    change, _ = exact_change(RangeRamp(start=20.0, duration=(20.05, 20.05), rate=(2.0, 2.0)))
    (column,) = set(np.argwhere(change[:, :CHANNELS] != 0.0)[:, 1])
    ramp, rate = change[DURING, column], change[DURING, CHANNELS + column]
    np.testing.assert_allclose(np.abs(ramp), 2.0 * np.arange(21.0), atol=1e-7)
    np.testing.assert_allclose(rate, np.sign(ramp[-1]) * 2.0, atol=1e-9)
    assert np.count_nonzero(change) == 20 + 21


def test_a_satellite_that_sets_is_not_confused_with_its_successor():
    scenario, recording = sampled([0])
    draft = scenario.draft(recording.truth[0], np.random.default_rng(5))
    before = draft.exact.copy()
    draft.satellite[:] = -1
    draft.satellite[200:300:10, 4], draft.satellite[300:410:10, 4] = 7, 8
    RangeStep(start=20.0, duration=(20.0, 20.0)).apply(draft, np.random.default_rng(0))
    moved = np.flatnonzero((draft.exact - before)[:, 4])
    assert len(moved) == 10 and (moved.max() < 300 or moved.min() >= 300)
    draft.satellite[:] = -1  # none in view: nothing to move
    RangeStep(start=20.0, duration=(20.0, 20.0)).apply(draft, np.random.default_rng(0))


def test_a_multipath_burst_hits_low_satellites():
    fault = MultipathBurst(start=20.0, duration=(20.05, 20.05), factor=(9.0, 9.0), below=40.0)
    change, draft = exact_change(fault)
    low = draft.elevation < np.radians(40.0)
    assert low[DURING].any() and not low[DURING].all() and not change.any()
    expected = np.ones_like(draft.noise_factor)
    expected[200:401, :CHANNELS][low[200:401]] = 9.0
    np.testing.assert_allclose(draft.noise_factor, expected)


def test_a_receiver_misreports_by_group():
    _, draft = exact_change(ReceiverMisreport(factor=(0.4, 2.5)))
    ranges, rates = np.split(draft.told_factor, 2, axis=1)
    assert np.ptp(ranges) == np.ptp(rates) == 0.0 and ranges[0, 0] != rates[0, 0]


@pytest.mark.parametrize("fault", [
    lambda: RangeStep(size=(0.0, 1.0)), lambda: RangeRamp(rate=(2.0, 1.0)),
    lambda: ClockDegradation(range_error=(-1.0, 1.0)), lambda: MultipathBurst(below=91.0),
    lambda: MultipathBurst(start=-1.0), lambda: PllFailure(duration=5.0),
])  # fmt: skip
def test_faults_are_checked(fault):
    with pytest.raises(ValueError, match=r"RangeStep|RangeRamp|Clock|Multipath|PllFailure"):
        fault()


# ----- the published case ---------------------------------------------------------------


def test_the_published_case():
    """Six satellites; the fault troubles height and acceleration, and nothing diverges."""
    scenario, recording = sampled(range(20), faults="paper", duration=250.0)
    assert recording.faults[0] == (
        ("clock degradation", 70.0, 100.0),
        ("PLL failure", 150.0, 165.0),
    )
    visible = np.isfinite(recording.measurement[:, ::10, :CHANNELS]).sum(axis=2)
    lost = (np.arange(251) >= 150) & (np.arange(251) < 165)
    assert (visible[:, lost] == 0).all() and (visible[:, ~lost] == 6).all()
    _, rotation = scenario.local_frame(recording.truth[0, 0, POSITION])
    off = filtered(scenario, recording) - recording.truth

    def rmse(first, last, components):
        error = off[:, 10 * first : 10 * last, components] @ rotation.T
        return np.sqrt(np.mean(error**2, axis=(0, 1)))

    assert (rmse(30, 70, POSITION) < [0.7, 0.8, 1.6]).all()
    assert (rmse(75, 100, POSITION) < [1.0, 1.3, 3.5]).all()
    assert (rmse(170, 250, POSITION) < [0.9, 1.1, 2.2]).all()
    assert rmse(75, 100, POSITION)[2] > 1.2 * rmse(30, 70, POSITION)[2]
    assert rmse(75, 100, [2, 5, 8]).max() > 2.0 * rmse(30, 70, [2, 5, 8]).max()


def test_the_printed_jacobian_costs_an_order_of_magnitude():
    """Appendix B under the clock fault: vertical RMSE 12 to 15 m instead of 2 m (SPEC 4.3)."""
    fault = ClockDegradation(start=15.0, duration=(20.0, 20.0), range_error=(150.0, 150.0))
    scenario, recording = sampled(faults=[fault], duration=30.0, date="2016-02-29T05:00")
    _, rotation = scenario.local_frame(recording.truth[0, 0, POSITION])

    def vertical(sensor):
        tier = ReferenceFilter(scenario.motion, sensor, "srukf-joseph", kappa=0.0)
        off = tier.history(recording).mean - recording.truth
        error = (off[:, 170:, POSITION] @ rotation.T)[..., 2]
        return np.sqrt(np.mean(error**2))

    right, printed = vertical(scenario.sensor), vertical(as_printed(0.1))
    assert right < 4.0 and printed > 3.0 * right


def test_the_environment_flies_it_whole():
    env = make(GNSS, faults="paper", duration=None)
    assert len(env.scenario.time) == 2501
    assert draw(GNSS, [0], faults="paper", duration=None).time[-1] == 250.0
