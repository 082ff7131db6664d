"""E6 at few runs: the paper's case and its variants, what is told of them (about 10 s)."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from kfenv.agents.reproduction import inertial_claims, inertial_figures, inertial_navigation
from kfenv.agents.reproduction.claims import FAILS, HOLDS, digits, with_interval
from kfenv.agents.reproduction.densities import noise_density, parts
from kfenv.agents.reproduction.inertial_case import CUBATURE, PaperCase, fix_errors
from kfenv.agents.reproduction.laboratory import Laboratory
from kfenv.agents.reproduction.monte_carlo import Outcome, Study
from rich.progress import Progress

from kfenv.filters.gaussian_sum import posterior_log_weights
from kfenv.scenarios.inertial.ins_gnss import InsGnss

COARSE = {"duration": 27.0, "rate": 10.0}


# -- the case ----------------------------------------------------------------------------


def drawn(count=1, **variant):
    rngs = [np.random.default_rng(seed) for seed in range(count)]
    return PaperCase(**COARSE, **variant).sample(rngs)


def test_the_case_is_that_of_the_environment():
    plain = InsGnss(**COARSE, faults="paper").sample([np.random.default_rng(0)])
    np.testing.assert_array_equal(drawn().measurement, plain.measurement)
    np.testing.assert_array_equal(drawn().motion_inputs, plain.motion_inputs)


@pytest.mark.parametrize("variant", [{"swing": 3.0}, {"shift": 1.0}])
def test_variants_meet_the_same_noise_and_are_not_told(variant):
    plain, other = drawn(), drawn(**variant)
    np.testing.assert_array_equal(plain.truth, other.truth)
    np.testing.assert_array_equal(plain.noise, other.noise)
    outside = (plain.time < 7.0) | (plain.time >= 26.0)
    np.testing.assert_array_equal(plain.measurement[:, outside], other.measurement[:, outside])
    assert np.nanmax(np.abs(plain.measurement - other.measurement)) > 0.0


def test_the_whole_mixture_varies():
    factor = drawn(swing=3.0).true_noise / drawn().true_noise
    time = np.arange(271) / 10.0
    np.testing.assert_allclose(np.ptp(factor, axis=2), 0.0, atol=1e-12)
    assert factor[0, time == 16.5, 0] == pytest.approx(3.0)
    np.testing.assert_allclose(factor[0, (time <= 7.0) | (time >= 26.0), 0], 1.0)
    rise = (time > 7.0) & (time < 16.0)
    assert np.all(np.diff(factor[0, rise, 0]) > 0.0)


@pytest.mark.parametrize("shift", [0.0, 1.0])
def test_the_fixes_have_the_density_that_is_drawn(shift):
    """Histogram against the mixture, and its two parts against their weights."""
    study = Study("s", PaperCase(**COARSE, shift=shift), CUBATURE, 40)
    noise = (fix_errors(study, 40) / study.scenario.fix_deviations)[..., :6].ravel()
    share, ratio = study.scenario.mixture
    x = np.linspace(-150.0, 150.0, 30001)
    nominal, outlying = (np.trapezoid(part, x) for part in parts(x, share, ratio, shift))
    assert nominal == pytest.approx(0.85) and outlying == pytest.approx(0.15)
    for low, high in ((-1.0, 1.0), (5.0, 30.0), (-30.0, -5.0)):
        grid = np.linspace(low, high, 2001)
        expected = np.trapezoid(sum(parts(grid, share, ratio, shift)), grid)
        # fixes are hit as a whole: some 7600 of them, six numbers each
        assert np.mean((noise > low) & (noise < high)) == pytest.approx(expected, abs=0.015)
    assert noise.mean() == pytest.approx(share * shift * np.sqrt(ratio), abs=0.4)
    assert len(noise_density(noise, share, ratio, shift).axes) == 2


# -- what is told of it --------------------------------------------------------------------


def outcome(study, error):
    """Of a filter whose errors (N, K, 9) are these, SI."""
    runs, steps = error.shape[:2]
    blank = np.ones((runs, steps))
    return Outcome(error, error, blank, blank, blank, blank, np.full(runs, np.inf),
                   np.zeros(runs, np.int64), np.zeros(runs, np.int64))  # fmt: skip


@pytest.fixture
def study():
    return Study("s", PaperCase(**COARSE), CUBATURE, 8, spacing=0.1)


@pytest.fixture
def noise(study):
    scale = np.repeat([10.0, 1.0, np.radians(1.0)], 3) * np.tile([1.0, 2.0, 2.0], 3)
    return scale * np.random.default_rng(0).choice([-1.0, 1.0], (8, len(study.time), 9))


def test_rmse_is_per_axis_and_in_degrees(study, noise):
    of = partial(inertial_claims.pooled, study, outcome(study, noise))
    assert of(inertial_claims.POSITION) == pytest.approx(10.0 * np.sqrt(3.0))
    assert of(inertial_claims.ATTITUDE) == pytest.approx(np.sqrt(3.0))
    assert of(inertial_claims.ANGLES["roll"]) == pytest.approx(1.0)
    assert of(inertial_claims.ANGLES["yaw"], (26.0, 27.0)) == pytest.approx(2.0)
    told = inertial_claims._told(study, {"F": outcome(study, noise)}, ["F"])
    assert told == "F 17.3 (30) m, 1.73 (3) m/s, 1.73 (3) deg"
    far = outcome(study, noise)._replace(lost_at=np.array([3.0] + 7 * [np.inf]))
    assert inertial_claims._told(study, {"F": far}, ["F"]) == f"{told}, 1 of 8 lost"
    gone = noise.copy()
    gone[3, -20:] = np.nan
    assert np.isinf(inertial_claims.rmse_of_runs(study, outcome(study, gone), 0)).sum() == 1


def test_only_an_angle_that_comes_apart_diverges(study, noise):
    apart = noise.copy()
    apart[:, study.time > 20.0, 8] *= np.linspace(4.0, 5.0, 8)[:, None]
    outcomes = {"AEKF": outcome(study, noise), "ACKF": outcome(study, apart)}
    verdicts = {
        angle: inertial_claims._diverges(study, outcomes, "C", angle, "AEKF", "ACKF").verdict
        for angle in inertial_claims.ANGLES
    }
    assert verdicts == {"yaw": HOLDS, "pitch": FAILS, "roll": FAILS}
    outcomes = {"AEKF": outcome(study, apart), "ACKF": outcome(study, noise)}
    claim = inertial_claims._diverges(study, outcomes, "C", "yaw", "AEKF", "ACKF")
    assert claim.verdict == FAILS


def test_when_a_single_channel_makes_an_outlier_as_likely_as_not():
    off = inertial_claims.suspected_at(9, 0.15, 500.0)
    variance = np.array([1.0, 500.0])
    likelihood = -0.5 * (off**2 / variance + 9.0 * np.log(2.0 * np.pi * variance))
    weights = posterior_log_weights(np.log([[0.85], [0.15]]), likelihood[:, None])
    np.testing.assert_allclose(np.exp(weights), 0.5)


def test_a_gain_is_not_sure_where_the_better_filter_failed():
    gains = np.linspace(1.0, 2.0, 20)
    failed = np.where(np.arange(20) == 3, -np.inf, gains)
    assert inertial_claims._surely_positive(gains)
    for lost in (failed, np.where(np.isinf(failed), np.nan, gains)):
        assert not inertial_claims._surely_positive(lost)
    assert inertial_claims._surely_positive(np.abs(failed))  # the worse one failed
    assert "lost" not in with_interval(gains)
    assert with_interval(failed).endswith("m without 1 of 20 runs, lost")
    assert [digits(value) for value in (0.12345, 12.345, 1234.5, 2e7)] == [
        "0.123", "12.3", "1234", "2e+07"
    ]  # fmt: skip


def test_the_experiment_writes_its_figures_and_claims(tmp_path, monkeypatch):
    """On few runs of coarse samples; the claims' verdicts are the specification's."""
    coarse = partial(PaperCase, duration=27.0, rate=5.0)
    monkeypatch.setattr(inertial_navigation, "PaperCase", coarse)
    names = inertial_figures.DRAWN
    assert [inertial_figures.CHANNELS[i].split(",")[0].replace(" ", "_") for i in names] == [
        *names.values()
    ]
    monkeypatch.setattr(inertial_figures, "DRAWN", {8: names[8]})  # one for all
    with Progress(disable=True) as progress:
        claims = inertial_navigation.reproduce(Laboratory(tmp_path, 4, 0, 1, progress))
    verdicts = {claim.name.removesuffix(" (E6)"): claim.verdict for claim in claims}
    assert verdicts["C11"] == verdicts["C11g"] == HOLDS
    for name in ("C11b", "C11c", "C11f", "C12 yaw", "C12 pitch", "C12 roll", "C12b"):
        assert verdicts[name] == FAILS, name
    assert {"C12c yaw", "C12c pitch", "C12c roll"} < set(verdicts)
    drawn = sorted(path.stem for path in Path(tmp_path).glob("*.png"))
    assert drawn == [
        "density", "density_not_centred", "rmse", "rmse_3d", "rmse_unit_fault", "rmse_varying",
        "yaw",
    ]  # fmt: skip
