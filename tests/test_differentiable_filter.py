"""The filter in torch is the engine's, to 1e-9, and its gradients are the slopes."""

import numpy as np
import pytest
from pairs import PAIRS, radar_case, robot_case, wrap

from kfenv.filters.engine import Engine
from kfenv.filters.protocol import Knobs, Measurement
from kfenv.filters.results import Prediction
from kfenv.models.radar import radar
from kfenv.models.variable_turn import variable_turn
from kfenv.scenarios.gnss.tracking import GnssTracking
from kfenv.scenarios.inertial.ins_gnss import InsGnss
from kfenv.scenarios.radar.bistatic import BistaticTracking
from kfenv.scenarios.radar.tracking import RadarTracking

torch = pytest.importorskip("torch")

from kfenv.agents.learning.teaching.differentiable import DifferentiableFilter, Predicted  # noqa: E402

TOLERANCE = 1e-9  # of a state's deviation, or of what an improbable innovation moves it by
ROUNDING = 4 * np.finfo(float).eps  # of a position or range of thousands of kilometres
SCENARIOS = [
    (RadarTracking, {"rate": 10.0}, 100),
    (RadarTracking, {"rate": 2.0}, 60),
    (BistaticTracking, {}, 60),
    (GnssTracking, {}, 60),
    (InsGnss, {}, 60),
]


@pytest.fixture(autouse=True)
def one_thread():
    """A second one gains nothing at this size, and loses much beside another program."""
    former = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(former)


def tensors(*arrays):
    return tuple(torch.tensor(array) for array in arrays)


def initial(mean, factor):
    """The first instant has no prediction: `predict`'s result in its place."""
    covariance = factor @ factor.mT
    failed = torch.zeros(len(mean), dtype=torch.bool, device=mean.device)
    return Predicted(mean, covariance, torch.zeros_like(covariance), failed)


def side_by_side(motion, sensor, recording, knobs, steps, kappa=1.0, alone=True):
    """Yield (engine's update, ours, the measurement) of each instant; knobs (B, T, 2 + m).

    Unless `alone`, ours takes every step from the engine's state.
    """
    engine, ours = Engine(motion, sensor, kappa), DifferentiableFilter(motion, sensor, kappa)
    batch, dt = len(recording.mean), np.diff(recording.time, prepend=0.0)
    status = np.zeros(batch, np.int64)
    mean, factor = recording.mean, recording.factor
    prediction = Prediction(mean, factor, np.zeros_like(factor))
    predicted, state = initial(*tensors(mean, factor)), None
    for t in range(steps):
        if t > 0:
            known = recording.motion_inputs[:, t], np.full(batch, dt[t])
            prediction = engine.predict(mean, factor, *known, status)
            predicted = ours.predict(*state, *tensors(*known))
        turned = Knobs(*knobs[:, t, :2].T)
        sd = recording.noise[:, t] * knobs[:, t, 2:]
        seen = Measurement(recording.sensor_inputs[:, t], recording.measurement[:, t], sd)
        told = engine.update(prediction, turned, seen, status)
        found = ours.update(predicted, *tensors(*turned, *seen))
        assert not status.any() and not found.failed.any()
        yield told, found, seen.value
        mean, factor = told.mean, told.factor
        state = found[:2] if alone else tensors(mean, factor @ np.swapaxes(factor, 1, 2))


def assert_same(told, found, value, motion):
    angles = [state.angle for state in motion.states]
    covariance = told.factor @ np.swapaxes(told.factor, 1, 2)
    deviation = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    difference = found.mean.numpy() - told.mean
    difference[:, angles] = wrap(difference[:, angles])
    size = np.sqrt(np.fmax(told.nis, 1.0))[:, None] * deviation
    assert (np.abs(difference) < TOLERANCE * size + ROUNDING * np.abs(told.mean)).all()
    difference = found.covariance.numpy() - covariance
    assert np.max(np.abs(difference) / deviation[:, :, None] / deviation[:, None]) < TOLERANCE
    present = ~np.isnan(told.innovation)
    innovation, variance = found.innovation.numpy(), found.variance.numpy()
    allowed = TOLERANCE * np.sqrt(told.variance) + ROUNDING * np.abs(value)
    assert (np.abs(innovation - told.innovation) < allowed)[present].all()
    np.testing.assert_allclose(variance[present], told.variance[present], rtol=TOLERANCE)
    assert (innovation[~present] == 0.0).all() and (variance[~present] == 1.0).all()


def random_knobs(recording, seed=0):
    """For each filter, instant and channel, from a third to three times the nominal one."""
    rng = np.random.default_rng(seed)
    batch, steps, channels = recording.measurement.shape
    knobs = 3.0 ** rng.uniform(-1.0, 1.0, (batch, steps, 2 + channels))
    knobs[:, :, 0] = np.abs(knobs[:, :, 0] - 1.0) * 0.1 + 1.0  # fading
    return knobs


@pytest.mark.parametrize(("scenario", "how", "steps"), SCENARIOS)
def test_every_step_of_episodes_with_faults(scenario, how, steps):
    """From the engine's state: a glint of 200 deviations drives two engines apart as well."""
    world = scenario(**how)
    recording = world.sample([np.random.default_rng(seed) for seed in range(3)])
    knobs = random_knobs(recording)
    for step in side_by_side(world.motion, world.sensor, recording, knobs, steps, alone=False):
        assert_same(*step, world.motion)


@pytest.mark.parametrize(
    ("name", "kappa", "steps", "how"),
    [
        ("variable turn, radar", 1.0, 180, {}),
        ("robot, beacon", 3.0, 60, {}),
        ("strapdown, navigation fix", 0.0, 60, {"dt": 0.05}),
    ],
)
def test_many_steps_alone_across_the_seam_of_angles(name, kappa, steps, how):
    motion, sensor, make_case = PAIRS[name]
    case = make_case(batch=2, **how)
    angles = case.measurement[:, :steps, [channel.angle for channel in sensor.channels]]
    assert np.isnan(angles).any() and np.nanmin(angles) < -3.1 and np.nanmax(angles) > 3.1
    for step in side_by_side(motion, sensor, case, random_knobs(case), steps, kappa):
        assert_same(*step, motion)


def opening(case, offsets, knobs, steps, device="cpu"):
    """Our filter's posteriors of the first instants of a case.

    Args:
        offsets: (B, n) of the initial mean, in deviations along the factor's columns.
        knobs: (B, 2 + m) logarithms of factors: fading, process scale, each channel's noise.
    """
    name = "variable turn, radar" if case.mean.shape[1] == 9 else "robot, beacon"
    motion, sensor, _ = PAIRS[name]
    ours = DifferentiableFilter(motion, sensor, device=device)
    mean, factor, _, u, s, z, sd = (array.to(device) for array in tensors(*case[:7]))
    predicted = initial(mean + (factor @ offsets[:, :, None])[:, :, 0], factor)
    posterior = predicted
    fading, process_scale, *noise = knobs.exp().unbind(1)
    for t in range(steps):
        if t > 0:
            dt = torch.full_like(fading, case.time[t] - case.time[t - 1])
            predicted = ours.predict(*posterior[:2], u[:, t], dt)
        told = sd[:, t] * torch.stack(noise, dim=1)
        posterior = ours.update(predicted, fading, process_scale, s[:, t], z[:, t], told)
        yield posterior


def leaves(case, scale=0.1):
    """Offsets and knobs that want gradients."""
    batch, channels = case.measurement[:, 0].shape
    rng = np.random.default_rng(0)
    shapes = (batch, case.mean.shape[1]), (batch, 2 + channels)
    return tuple(
        torch.tensor(scale * rng.normal(size=shape), requires_grad=True) for shape in shapes
    )


@pytest.mark.parametrize("make_case", [radar_case, robot_case])
def test_gradients_are_the_slopes(make_case):
    case = make_case(batch=2, steps=4)
    assert np.isnan(case.measurement).any()
    deviation = torch.tensor(np.sqrt(np.sum(case.factor**2, axis=2)))
    rng = np.random.default_rng(1)
    shapes = deviation.shape, case.factor.shape, case.measurement[:, 0].shape
    a, b, c = tensors(*(rng.normal(size=shape) for shape in shapes))

    def outputs(offsets, knobs):
        *_, last = opening(case, offsets, knobs, 4)
        spread = last.covariance / deviation[:, :, None] / deviation[:, None]
        whitened = last.innovation / last.variance.sqrt()
        sums = (a * last.mean / deviation).sum(1), (b * spread).sum((1, 2)), (c * whitened).sum(1)
        return torch.stack(sums)

    how = {"eps": 1e-5, "atol": 1e-6, "rtol": 1e-5, "check_undefined_grad": False}
    assert torch.autograd.gradcheck(outputs, leaves(case), **how)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a graphics processor")
@pytest.mark.parametrize("make_case", [radar_case, robot_case])
def test_a_graphics_processor_finds_the_same_and_its_gradients(make_case):
    case, found = make_case(batch=64, steps=100), {}
    for device in ("cpu", "cuda"):
        offsets, knobs = (leaf.detach().to(device).requires_grad_() for leaf in leaves(case))
        *_, last = opening(case, offsets, knobs, 100, device)
        assert not last.failed.any()
        slopes = torch.autograd.grad(last.mean.sum(), (offsets, knobs))
        found[device] = [part.detach().cpu() for part in (*last[:4], *slopes)]
    for here, there in zip(found["cpu"], found["cuda"], strict=True):
        torch.testing.assert_close(there, here, rtol=1e-9, atol=1e-9 * float(here.abs().max()))


def test_a_batch_where_nothing_arrives_is_predicted():
    case = radar_case(batch=2, steps=3)
    case.measurement[0, 1:] = np.nan
    offsets, knobs = leaves(case, scale=0.0)
    *_, before, last = opening(case, offsets, knobs, 3)
    ours = DifferentiableFilter(variable_turn(), radar())
    dt = torch.full((2,), case.time[1], dtype=torch.float64)
    predicted = ours.predict(*before[:2], torch.zeros(2, 0), dt)
    torch.testing.assert_close(last.mean[0], predicted.mean[0], rtol=1e-14, atol=0.0)
    expected = (predicted.propagated + predicted.noise)[0]
    torch.testing.assert_close(last.covariance[0], expected, rtol=1e-11, atol=1e-11)
    assert torch.autograd.grad(last.mean[0].sum(), knobs)[0].isfinite().all()


def test_a_turn_more_of_an_angle_is_no_other_measurement():
    case = robot_case(batch=3, steps=40)
    offsets, knobs = leaves(case)
    once = list(opening(case, offsets, knobs, 40))
    case.measurement[:, :, 1:3] -= 2.0 * np.pi
    again = list(opening(case, offsets, knobs, 40))
    torch.testing.assert_close(again[-1].mean, once[-1].mean, rtol=1e-9, atol=1e-9)
    headings = torch.stack([posterior.mean[:, 2] for posterior in once])
    assert (headings.abs() <= np.pi).all() and headings.max() > 3.0 and headings.min() < -3.0


@pytest.mark.parametrize("spoiled", ["indefinite", "huge", "not a number"])
def test_a_failed_filter_is_told_and_its_neighbours_do_not_notice(spoiled):
    case = radar_case(batch=3, steps=5)
    sound = case.only([0, 2])
    if spoiled == "indefinite":
        case.factor[1, 4:6] = 0.0
    else:
        case.mean[1, 1] = 1e200 if spoiled == "huge" else np.nan
    slopes, ends = [], []
    for one, filters in ((case, [0, 2]), (sound, [0, 1])):
        shared = torch.zeros(1, 5, dtype=torch.float64, requires_grad=True)
        offsets = torch.zeros(one.mean.shape, dtype=torch.float64)
        posteriors = list(opening(one, offsets, shared.expand(len(one.mean), 5), 5))
        sum(posterior.mean[filters].sum() for posterior in posteriors).backward()
        slopes.append(shared.grad)
        ends.append(posteriors[-1].covariance[filters])
        failed = torch.stack([posterior.failed for posterior in posteriors])
        assert not failed[:, filters].any()
        if one is case:
            assert failed[:2, 1].any()
            assert all(result.isfinite().all() for last in posteriors for result in last[:4])
    torch.testing.assert_close(*ends, rtol=1e-12, atol=0.0)
    torch.testing.assert_close(*slopes, rtol=1e-12, atol=0.0)


def test_what_failed_in_the_prediction_has_failed_in_the_update():
    ours = DifferentiableFilter(variable_turn(), radar())
    mean, covariance = torch.ones(2, 9).double(), torch.eye(9).double().repeat(2, 1, 1)
    covariance[1, 3, 3] = -1.0
    ones, nothing = torch.ones(2).double(), torch.zeros(2, 0)
    predicted = ours.predict(mean, covariance, nothing, ones)
    value = torch.full((2, 3), float("nan")).double()
    posterior = ours.update(predicted, ones, ones, nothing, value, torch.ones(2, 3).double())
    assert predicted.failed.tolist() == posterior.failed.tolist() == [False, True]
    assert (posterior.mean[1] == 1.0).all() and (posterior.covariance[1] == torch.eye(9)).all()


@pytest.mark.parametrize("kappa", [-1.0, float("nan"), float("inf")])
def test_kappa_is_checked_at_the_door(kappa):
    with pytest.raises(ValueError, match="kappa must be a non-negative number"):
        DifferentiableFilter(variable_turn(), radar(), kappa)
