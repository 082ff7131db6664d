"""The compiled gradient through the filter is the reference's, and models' slopes are exact."""

import numpy as np
import pytest
from pairs import PAIRS, radar_case, robot_case

from kfenv.filters.results import Prediction
from kfenv.models.namespaces import batch, dual
from kfenv.scenarios.gnss.tracking import GnssTracking
from kfenv.scenarios.inertial.ins_gnss import InsGnss
from kfenv.scenarios.radar.bistatic import BistaticTracking
from kfenv.scenarios.radar.tracking import RadarTracking

torch = pytest.importorskip("torch")

from kfenv.agents.learning.teaching.differentiable import DifferentiableFilter, Predicted  # noqa: E402
from kfenv.agents.learning.teaching.gradients import kernel  # noqa: E402
from kfenv.agents.learning.teaching.gradients.filtering import (  # noqa: E402
    FilterWithGradient,
    Series,
)

TOLERANCE = 1e-9  # of an episode's gradient, and of its loss
STEPS = 6
RADAR = (*PAIRS["variable turn, radar"][:2], 1.0)  # and kappa, as other tests compile them


def series_of(case):
    """The first instants of a case, time first."""
    first = (case.measurement, case.sensor_inputs, case.motion_inputs)
    dt = np.diff(case.time[:STEPS], prepend=case.time[0])
    dt = np.repeat(dt[:, None], len(case.mean), axis=1)
    return Series(*(array[:, :STEPS].swapaxes(0, 1).copy() for array in first), dt)


def turned(case):
    """Knobs (T, B, 2 + n) and deviations (T, B, m) that want gradients."""
    rng = np.random.default_rng(0)
    batch, n = case.mean.shape
    knobs = 2.0 ** rng.uniform(-1.0, 1.0, (STEPS, batch, 2 + n))
    told = case.noise[:, :STEPS].swapaxes(0, 1) * 2.0 ** rng.uniform(-1.0, 1.0, (STEPS, batch, 1))
    return tuple(torch.tensor(array, requires_grad=True) for array in (knobs, told))


def by_reference(models, case, knobs, told):
    """Posteriors of the filter in torch."""
    series = [torch.tensor(part) for part in series_of(case)]
    ours = DifferentiableFilter(*models)
    value, sensor_inputs, motion_inputs, dt = series
    mean, factor = torch.tensor(case.mean), torch.tensor(case.factor)
    failed = torch.zeros(len(mean), dtype=torch.bool)
    predicted = Predicted(mean, factor @ factor.mT, torch.zeros_like(factor), failed)
    found = []
    for t in range(STEPS):
        if t > 0:
            predicted = ours.predict(*found[-1][:2], motion_inputs[t], dt[t])
        deviation = knobs[t, :, 2:]
        noise = predicted.noise * deviation[:, :, None] * deviation[:, None, :]
        predicted = predicted._replace(noise=noise)
        scales = knobs[t, :, 0], knobs[t, :, 1]
        found.append(ours.update(predicted, *scales, sensor_inputs[t], value[t], told[t]))
    return torch.stack([one.mean for one in found]), torch.stack([one.covariance for one in found])


def by_sweep(models, case, knobs, told):
    """Posteriors of the engine, whose gradient is compiled, and which are sound."""
    start = Prediction(case.mean, case.factor, np.zeros_like(case.factor))
    return FilterWithGradient(*models).run(start, series_of(case), knobs, told)


def losses(case, mean, covariance):
    """Of each episode: a random sum of all that was found, in initial deviations."""
    rng = np.random.default_rng(1)
    deviation = torch.tensor(np.sqrt(np.sum(case.factor**2, axis=2)))
    a, b = (torch.tensor(rng.normal(size=part.shape)) for part in (mean, covariance))
    spread = covariance / deviation[:, :, None] / deviation[:, None]
    return (a * mean / deviation).sum((0, 2)) + (b * spread).sum((0, 2, 3))


@pytest.mark.parametrize("make_case", [radar_case, robot_case])
def test_the_sweep_has_the_references_gradient(make_case):
    case = make_case(batch=10, steps=STEPS)  # of eight lanes and two
    case.measurement[:, 3] = np.nan  # nobody hears anything
    models = RADAR if make_case is radar_case else (*PAIRS["robot, beacon"][:2], 3.0)
    given = turned(case)
    expected = losses(case, *by_reference(models, case, *given))
    slopes = torch.autograd.grad(expected.sum(), given)
    *posterior, sound = by_sweep(models, case, *given)
    found = losses(case, *posterior)
    assert sound.all()
    torch.testing.assert_close(found, expected, rtol=TOLERANCE, atol=0.0)
    for slope, told in zip(slopes, torch.autograd.grad(found.sum(), given), strict=True):
        size = slope.norm(dim=(0, 2))
        assert ((told - slope).norm(dim=(0, 2)) < TOLERANCE * size).all() and (size > 0.0).all()


def test_no_gradient_passes_a_failed_filter_and_its_neighbours_do_not_notice():
    case = radar_case(batch=3, steps=STEPS)
    kept = [0, 2]
    spoilt = case._replace(noise=case.noise.copy())
    spoilt.noise[1, 3] = np.inf
    found = []
    for one in (case, spoilt):
        given = turned(one)
        mean, covariance, sound = by_sweep(RADAR, one, *given)
        total = losses(one, mean, covariance)[kept].sum() + mean[:3, 1].sum()
        found.append(torch.autograd.grad(total, given)[0])
    assert sound[:, kept].all() and sound[:3, 1].all() and not sound[3:, 1].any()
    assert torch.equal(found[0], found[1]) and found[0][:3, 1].abs().sum() > 0.0


class Lines:
    """What the text of a model's functions is run on instead of lanes: NumPy."""

    functions = {name: getattr(batch, name) for name in batch.__all__} | {
        "load": lambda v, k: v[k].copy(),
        "store": lambda v, k, value: v.__setitem__(k, value),
        "lift": lambda value: value,
        "plain": lambda number: number,
        "where_greater": lambda a, b, x, y: np.where(a > b, x, y),
        "polynomial": kernel._polynomial.py_func,
    }


def places_and_inputs(world):
    """States (n, 8) about those that episodes begin with, and the inputs (k, 8) of step 1."""
    rngs = [np.random.default_rng(seed) for seed in range(8)]
    recording = world.sample(rngs)
    off = np.stack([rng.normal(size=recording.mean.shape[1]) for rng in rngs])
    x = recording.mean + np.einsum("bij,bj->bi", recording.factor, off)
    dt = np.full((1, 8), recording.time.ravel()[1] - recording.time.ravel()[0])
    told = np.concatenate([recording.motion_inputs[:, 1].T, dt])
    return x.T, told, recording.sensor_inputs[:, 1].T


@pytest.mark.parametrize("scenario", [RadarTracking, BistaticTracking, GnssTracking, InsGnss])
def test_the_text_of_a_model_has_its_values_and_the_transposed_slopes(scenario):
    world = scenario()
    motion, sensor = world.motion, world.sensor
    x, told, known = places_and_inputs(world)
    at, rng = kernel.layout(motion, sensor, 1.0), np.random.default_rng(0)
    source = kernel.source_of(motion, sensor, at, "x")
    functions = Lines.functions | source.tables
    exec("\n".join(source.lines), functions)
    step, noise, measure = *motion.build(dual), sensor.build(dual)
    cases = (
        ("step", step, told, at.motion_inputs, at.values, at.of_values, at.p, at.of_points, at.p),
        ("measure", measure, known, at.sensor_inputs, at.values, at.of_values, at.p,
         at.of_points, at.p),
        ("noise", noise, told, at.motion_inputs, None, at.of_entries, 1, at.of_state, 1),
    )  # fmt: skip
    for name, call, u, inputs, values, slopes, stride, ends, end_stride in cases:
        w = rng.normal(size=(1, at.end, 8))
        v = w[0]
        v[inputs : inputs + len(u)] = u
        v[at.mean : at.mean + len(x)] = v[at.points : at.points + len(x) * at.p : at.p] = x
        rest = (tuple(u[:-1]), u[-1]) if name != "measure" else (tuple(u),)
        with np.errstate(all="ignore"):  # at the other points are no states
            parts = call(dual.seed(x.T), *rest)
            if values is not None:
                functions[f"{name}_x"](w)
            of_values = v[slopes : slopes + len(parts) * stride : stride].copy()
            functions[f"pull_{name}_x"](w)
        expected = np.zeros_like(x)
        for k, part in enumerate(parts):
            if isinstance(part, dual.Dual):
                expected += of_values[k] * part.gradient.T
            if values is not None:
                np.testing.assert_allclose(v[values + k * at.p], part.value, rtol=1e-12, atol=1e-12)
        found = v[ends : ends + len(x) * end_stride : end_stride]
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
