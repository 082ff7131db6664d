"""The fused engine and the reference filter are the same filter, to 1e-9 over hundreds of steps."""

import pickle
from types import SimpleNamespace

import numpy as np
import pytest
from pairs import PAIRS, Case, radar_case, wrap

from kfenv.filters import engine
from kfenv.filters.engine import Engine
from kfenv.filters.protocol import Measurement, measured
from kfenv.filters.reference import ReferenceFilter
from kfenv.filters.results import Prediction
from kfenv.models.radar import radar
from kfenv.models.variable_turn import variable_turn
from kfenv.scenarios.radar.tracking import RadarTracking

TOLERANCE = 1e-9
# Each choice costs seconds of compilation; the spread of the points does not know the models.
CHOICES = [
    ("variable turn, radar", 1.0),
    ("constant acceleration, radar", 1.0),
    ("constant acceleration, position", 1.0),
    ("robot, beacon", 3.0),
    ("strapdown, navigation fix", 1.0),
    ("strapdown, navigation fix", 0.0),
]


def step_through(tier, case: Case):
    """Yield (innovation only, update) of every time of a recording."""
    batch = len(case.mean)
    status = np.zeros(batch, np.int64)
    mean, factor = case.mean, case.factor
    prediction = None
    for t in range(len(case.time)):
        if t == 0:
            prediction = Prediction(mean, factor, np.zeros_like(factor))
        else:
            dt = np.full(batch, case.time[t] - case.time[t - 1])
            prediction = tier.predict(mean, factor, case.motion_inputs[:, t], dt, status)
        pending = prediction, case.knobs, measured(case, t), status
        looked, updated = tier.innovate(*pending), tier.update(*pending)
        mean, factor = updated.mean, updated.factor
        assert not status.any()
        yield looked, updated


def assert_same_update(a, b, angles):
    """Means and factors within TOLERANCE of each state's deviation, the rest of its size."""
    deviation = np.sqrt(np.sum(b.factor**2, axis=2))
    difference = a.mean - b.mean
    difference[:, angles] = wrap(difference[:, angles])
    assert np.max(np.abs(difference) / deviation) < TOLERANCE
    assert np.max(np.abs(a.factor - b.factor) / deviation[:, :, None]) < TOLERANCE
    sd = np.sqrt(b.variance)
    for x, y, scale in (
        (a.innovation, b.innovation, sd), (a.variance, b.variance, b.variance),
        (a.whitened, b.whitened, 1.0), (a.nis, b.nis, 1.0 + np.abs(b.nis)),
        (a.log_likelihood, b.log_likelihood, 1.0 + np.abs(b.log_likelihood)),
    ):  # fmt: skip
        np.testing.assert_array_equal(np.isnan(x), np.isnan(y))
        assert np.nanmax(np.abs(x - y) / scale, initial=0.0) < TOLERANCE


@pytest.mark.parametrize(("name", "kappa"), CHOICES)
def test_every_step(name, kappa):
    motion, sensor, make_case = PAIRS[name]
    case = make_case()
    angles = [i for i, state in enumerate(motion.states) if state.angle]
    engine = step_through(Engine(motion, sensor, kappa), case)
    reference = step_through(ReferenceFilter(motion, sensor, "srukf-joseph-exact", kappa), case)
    for (looked, updated), (looked_too, updated_too) in zip(engine, reference, strict=True):
        assert_same_update(looked, looked_too, angles)
        assert_same_update(updated, updated_too, angles)


@pytest.mark.parametrize(("name", "kappa"), [CHOICES[0], *CHOICES[3:5]])
def test_whole_runs(name, kappa):
    motion, sensor, make_case = PAIRS[name]
    case = make_case()
    fast = Engine(motion, sensor, kappa).run(case, case.knobs)
    plain = ReferenceFilter(motion, sensor, kappa=kappa).history(case, case.knobs)
    assert not fast.status.any() and not plain.status.any()
    deviation = np.sqrt(np.diagonal(plain.covariance, axis1=2, axis2=3))
    difference = fast.mean - plain.mean
    for i, state in enumerate(motion.states):
        if state.angle:
            difference[..., i] = wrap(difference[..., i])
    assert np.max(np.abs(difference) / deviation) < TOLERANCE
    np.testing.assert_allclose(fast.nis, plain.nis, rtol=TOLERANCE, atol=TOLERANCE)


def test_run_is_the_steps_one_by_one():
    motion, sensor, make_case = PAIRS["variable turn, radar"]
    case = make_case()
    for tier in (Engine(motion, sensor), ReferenceFilter(motion, sensor)):
        run = tier.run(case, case.knobs)
        for t, (_, updated) in enumerate(step_through(tier, case)):
            np.testing.assert_allclose(run.mean[:, t], updated.mean, rtol=1e-11, atol=1e-9)


def test_a_lane_alone_gives_the_bits_of_eight():
    motion, sensor, make_case = PAIRS["variable turn, radar"]
    case = make_case()
    steps = (step_through(Engine(motion, sensor, lanes=lanes), case) for lanes in (1, 8))
    for alone, together in zip(*steps, strict=True):
        for mine, theirs in zip([*alone[0], *alone[1]], [*together[0], *together[1]], strict=True):
            np.testing.assert_array_equal(mine, theirs)


def test_what_is_taken_of_a_recording_can_be_written():
    """Numba compiles for arrays that are read-only, as a recording's are, anew: seconds."""
    recording = RadarTracking(duration=2.0).sample([np.random.default_rng(0)])
    assert not recording.measurement.flags.writeable
    assert all(array.flags.carray for array in measured(recording, 1))


@pytest.mark.parametrize("tier", [Engine, ReferenceFilter])
def test_a_filter_has_the_same_bits_alone_and_in_a_batch(tier):
    case = radar_case(batch=5, steps=80)
    together = tier(variable_turn(), radar()).run(case, case.knobs)
    for b in range(5):
        one = case.only([b])
        alone = tier(variable_turn(), radar()).run(one, one.knobs)
        np.testing.assert_array_equal(alone.mean[0], together.mean[b])
        np.testing.assert_array_equal(alone.nis[0], together.nis[b])


def test_arrays_of_any_kind_reach_the_kernel_alike(monkeypatch):
    """Numba would compile for read-only and for strided ones anew, ten seconds each."""
    case, met = radar_case(batch=2, steps=3), []

    def look(*arguments):
        met.extend(array for array in arguments if isinstance(array, np.ndarray))

    tier, status = Engine(variable_turn(), radar()), np.zeros(2, np.int64)
    monkeypatch.setattr(tier, "_kernel", SimpleNamespace(advance=look))
    monkeypatch.setattr(engine, "_tabulate", look)
    mean, factor = case.mean[::-1, ::-1], np.swapaxes(case.factor, 1, 2)
    pending = Measurement(*(a[:, 1] for a in (case.sensor_inputs, case.measurement, case.noise)))
    for array in pending:
        array.flags.writeable = False
    tier.predict(mean, factor, case.motion_inputs[:, 1], np.broadcast_to(0.2, 2), status)
    tier.update(Prediction(mean, factor, factor), case.knobs, pending, status)
    assert len(met) > 20 and all(array.flags.carray for array in met)


def test_a_reference_filter_pickles():
    case = radar_case(batch=2, steps=20)
    tier = ReferenceFilter(variable_turn(), radar(), "srukf-joseph", kappa=2.0)
    again = pickle.loads(pickle.dumps(tier))
    np.testing.assert_array_equal(again.run(case, case.knobs).mean, tier.run(case, case.knobs).mean)


def test_compiled_code_is_kept_under_a_name_of_what_it_was_made_of(tmp_path, monkeypatch):
    """Numba looks only at the file of the entry points: a change of the cycle must rename them."""
    models = variable_turn(), radar(), 1.0, 8
    before = engine._kernel.__wrapped__(*models).__name__
    assert engine._kernel.__wrapped__(*models).__name__ == before
    changed = tmp_path / "cycle.py"
    changed.write_text(engine.CYCLE.read_text() + "# changed")
    monkeypatch.setattr(engine, "CYCLE", changed)
    assert engine._kernel.__wrapped__(*models).__name__ != before
