"""Single-epoch positions from pseudoranges: weighted least squares, all epochs at once."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import timedelta
from warnings import warn

import numpy as np
from numpy.typing import NDArray

from kfenv.models.gnss.atmosphere import klobuchar, troposphere
from kfenv.models.gnss.orbits import (
    GPS_EPOCH,
    SPEED_OF_LIGHT,
    geodetic,
    look_angles,
    turned_with_earth,
)
from kfenv.models.gnss.receiver import CODE_NOISE, RATE_NOISE, range_deviation
from kfenv.scenarios.gnss.ephemeris import Ephemerides, satellite_states
from kfenv.scenarios.gnss.rinex import L1, PER_SYSTEM, Observations

Array = NDArray[np.float64]

MASK = np.radians(10.0)  # elevation below which a satellite is not used
UNMODELLED = 0.5  # share of the ionosphere's delay that the broadcast model leaves, 1 sigma
FEW_WITHOUT = 0.05  # share of the observations that may lack an ephemeris untold
STEPS, ROUGH_STEPS = 8, 4  # of Gauss and Newton; the first ones do without delays and weights
FARTHEST, SETTLED = 1e8, 1.0  # m: places and last steps beyond are no solutions
SINGULAR = 1e-4  # least entry on the diagonal of a geometry's factor, per weight


@dataclass(frozen=True, eq=False)
class Signals:
    """Pseudoranges of satellites whose orbits are known, cleared of the satellites' clocks.

    Attributes:
        time: (T,) of reception by the receiver's clock, seconds since the GPS epoch.
        pseudorange: (T, S) m, NaN where there is none.
        rate: (T, S) its rate from the Doppler, m/s, NaN where there is none.
        position, velocity: (T, S, 3) of the satellite at transmission, in the ECEF frame
            of that instant, m and m/s; NaN where there is no pseudorange.
        alpha, beta: (4,) each, the ionosphere's broadcast coefficients.
        system: (S,) number of each satellite's system, 0 of GPS.
        frequency: (S,) Hz.
        strength: (T, S) C/N0, dB-Hz, NaN where it is not told.
        code_noise, rate_noise: (T, S) the receiver's, m and m/s, 1 sigma.
    """

    time: Array
    pseudorange: Array
    rate: Array
    position: Array
    velocity: Array
    alpha: Array
    beta: Array
    system: NDArray[np.int64]
    frequency: Array
    strength: Array
    code_noise: Array
    rate_noise: Array


@dataclass(frozen=True, eq=False)
class View:
    """What a receiver at known places sees of the signals; (T, S) each, NaN where none.

    Attributes:
        position, velocity: (T, S, 3) of the satellites, ECEF of the reception.
        pseudorange: cleared of the delays in troposphere and ionosphere, m.
        deviation: standard deviation of the cleared pseudorange, from the error budget, m.
        elevation: rad.
    """

    position: Array
    velocity: Array
    pseudorange: Array
    deviation: Array
    elevation: Array


@dataclass(frozen=True, eq=False)
class Fixes:
    """Least-squares solutions of single epochs; NaN where there is none.

    Attributes:
        position: (T, 3) ECEF, m.
        bias: (T,) of the receiver's clock, m.
        covariance: (T, 4, 4) of position and bias, m^2.
        velocity: (T, 3) ECEF, m/s, from Doppler.
        drift: (T,) of the receiver's clock, m/s, from Doppler.
        rate_covariance: (T, 4, 4) of velocity and drift, (m/s)^2.
    """

    position: Array
    bias: Array
    covariance: Array
    velocity: Array
    drift: Array
    rate_covariance: Array


def signals(observations: Observations, ephemerides: Ephemerides) -> Signals:
    """Join observations with the orbits and clocks of their satellites.

    A system of which the navigation file has nothing is passed over. Noise is what the error
    budget has, whatever the C/N0 (see `kfenv.scenarios.gnss.calibration`).

    Raises:
        ValueError: if no observation has an ephemeris, or the ionosphere's coefficients
            are missing.
    """
    if ephemerides.klobuchar is None:
        raise ValueError(
            f"{ephemerides.path}: its header lacks the ionosphere's coefficients (ION ALPHA and "
            "ION BETA, or GPSA and GPSB under IONOSPHERIC CORR); take another navigation file of "
            "that day."
        )
    system = observations.satellite // PER_SYSTEM
    known = np.isin(system, ephemerides.satellite // PER_SYSTEM)
    observations = observations.of(known)
    received = np.broadcast_to(observations.time[:, None], observations.pseudorange.shape)
    row = ephemerides.choose(observations.satellite, received)
    row = np.where(np.isnan(observations.pseudorange), -1, row)
    _check_coverage(observations, ephemerides, row)
    by_satellite = received - observations.pseudorange / SPEED_OF_LIGHT  # by its own clock
    clock = satellite_states(ephemerides, row, by_satellite).clock
    states = satellite_states(ephemerides, row, by_satellite - clock)
    rate = -observations.doppler * SPEED_OF_LIGHT / observations.frequency
    return Signals(
        time=observations.time,
        pseudorange=observations.pseudorange + SPEED_OF_LIGHT * states.clock,
        rate=rate + SPEED_OF_LIGHT * states.clock_rate,
        position=states.position,
        velocity=states.velocity,
        alpha=ephemerides.klobuchar[:4],
        beta=ephemerides.klobuchar[4:],
        system=system[known],
        frequency=observations.frequency,
        strength=observations.strength,
        code_noise=np.full(rate.shape, CODE_NOISE),
        rate_noise=np.full(rate.shape, RATE_NOISE),
    )


def _check_coverage(observations: Observations, ephemerides: Ephemerides, row: Array) -> None:
    """Complain, or warn, of observations without an ephemeris (rows -1)."""
    observed = np.isfinite(observations.pseudorange)
    share = float((row < 0)[observed].mean()) if observed.any() else 1.0
    if share <= FEW_WITHOUT:
        return
    told = (
        f"{ephemerides.path} has ephemerides from {_minute(ephemerides.time.min())} to "
        f"{_minute(ephemerides.time.max())}, {observations.path} observations from "
        f"{_minute(observations.time[0])} to {_minute(observations.time[-1])}"
    )
    if share == 1.0:
        raise ValueError(
            f"{told}: none has a valid ephemeris, the two files do not belong together."
        )
    lacking = ", ".join(observations.names[((row < 0) & observed).any(axis=0)])
    warn(
        f"{told}: {100.0 * share:.0f} % of them have none and are not used (of {lacking}).",
        stacklevel=2,
    )


def _minute(time: float) -> str:
    return f"{GPS_EPOCH + timedelta(seconds=round(time / 60.0) * 60):%Y-%m-%d %H:%M}"


def view(signals: Signals, receiver: Array) -> View:
    """Return what a receiver at (T, 3), ECEF m, sees; satellites below the mask are left out."""
    flight, _ = _flight(signals, receiver)
    position = turned_with_earth(signals.position, flight)
    velocity = turned_with_earth(signals.velocity, flight)
    elevation, azimuth = look_angles(receiver, position)
    low = ~(elevation >= MASK) | np.isnan(signals.pseudorange)  # NaN is low
    latitude, longitude, height = (value[:, None] for value in geodetic(receiver))
    shown = np.where(low, np.pi / 2.0, elevation)
    time = signals.time[:, None]
    ionosphere = klobuchar(
        signals.alpha, signals.beta, latitude, longitude, shown, azimuth, time
    ) * (L1 / signals.frequency) ** 2  # fmt: skip
    delay = ionosphere + troposphere(shown, latitude, height, _day_of_year(time))
    deviation = np.hypot(range_deviation(shown, signals.code_noise), UNMODELLED * ionosphere)
    pseudorange = signals.pseudorange - delay
    for array in (position, velocity, pseudorange, deviation, elevation):
        array[low] = np.nan
    return View(position, velocity, pseudorange, deviation, elevation)


def fix(signals: Signals) -> Fixes:
    """Solve every epoch by itself, from the centre of the Earth.

    Position and clock bias come from the pseudoranges, velocity and drift from the
    Doppler, each weighted by the error budget. An epoch needs four satellites above 10 deg.
    """
    receiver, bias = np.zeros((len(signals.time), 3)), np.zeros(len(signals.time))
    for step in range(STEPS):
        if step < ROUGH_STEPS:
            flight, distance = _flight(signals, receiver)
            position = turned_with_earth(signals.position, flight)
            pseudorange, weight = signals.pseudorange, np.isfinite(signals.pseudorange) * 1.0
        else:
            seen = view(signals, receiver)
            position, pseudorange = seen.position, seen.pseudorange
            distance = np.linalg.norm(position - receiver[:, None], axis=-1)
            weight = np.nan_to_num(1.0 / seen.deviation)
        change, covariance = least_squares(
            range_slopes(position, receiver), pseudorange - distance - bias[:, None], weight
        )
        receiver, bias = receiver + change[:, :3], bias + change[:, 3]
        receiver[~(np.abs(receiver).max(axis=1) < FARTHEST)] = np.nan
    unsettled = ~(np.abs(change).max(axis=1) < SETTLED)
    receiver[unsettled], bias[unsettled], covariance[unsettled] = np.nan, np.nan, np.nan
    rates, rate_covariance = _rates(signals, receiver)
    return Fixes(receiver, bias, covariance, rates[:, :3], rates[:, 3], rate_covariance)


def clock_bias(signals: Signals, receiver: Array) -> Array:
    """Return the clock's bias (T,) of a receiver at known places (T, 3), m; NaN without signals."""
    seen = view(signals, receiver)
    distance = np.linalg.norm(seen.position - receiver[:, None], axis=-1)
    weight = np.nan_to_num(seen.deviation**-2)
    total = weight.sum(axis=1)
    mean = (weight * np.nan_to_num(seen.pseudorange - distance)).sum(axis=1)
    return np.divide(mean, total, out=np.full(len(total), np.nan), where=total > 0.0)


def _rates(signals: Signals, receiver: Array) -> tuple[Array, Array]:
    """Velocity and drift (T, 4) with their covariance."""
    seen = view(signals, receiver)
    directions = range_slopes(seen.position, receiver)
    along = -np.sum(directions[..., :3] * seen.velocity, axis=-1)
    weight = np.isfinite(along) & np.isfinite(signals.rate)
    return least_squares(directions, signals.rate - along, weight / signals.rate_noise)


def _flight(signals: Signals, receiver: Array) -> tuple[Array, Array]:
    """Times of flight (T, S) to (T, 3), s, and the distances, m, in the reception's frame."""
    distance = np.zeros(signals.pseudorange.shape)
    for _ in range(3):  # each pass gains five digits
        flight = distance / SPEED_OF_LIGHT
        turned = turned_with_earth(signals.position, flight)
        distance = np.linalg.norm(turned - receiver[:, None], axis=-1)
    return distance / SPEED_OF_LIGHT, distance


def range_slopes(position: Array, receiver: Array) -> Array:
    """Rows (T, S, 4): how a pseudorange changes with the receiver's position and clock."""
    line = receiver[:, None] - position
    unit = line / np.linalg.norm(line, axis=-1, keepdims=True)
    return np.concatenate((unit, np.ones((*unit.shape[:2], 1))), axis=-1)


def least_squares(rows: Array, residual: Array, weight: Array) -> tuple[Array, Array]:
    """Solve (T, S, 4) x = (T, S); NaN where the rows with weight do not determine x."""
    used = weight > 0.0
    rows = np.where(used[..., None], rows, 0.0) * weight[..., None]
    residual = np.where(used, residual, 0.0) * weight
    short = max(0, 4 - rows.shape[1])
    rows = np.pad(rows, ((0, 0), (0, short), (0, 0)))
    residual = np.pad(residual, ((0, 0), (0, short)))
    q, r = np.linalg.qr(rows)
    diagonal = np.abs(np.diagonal(r, axis1=1, axis2=2))
    lost = ~(diagonal.min(axis=1) > SINGULAR * weight.max(axis=1))
    r[lost] = np.eye(4)
    right = np.concatenate(
        (np.swapaxes(q, 1, 2) @ residual[..., None], np.broadcast_to(np.eye(4), r.shape)), axis=-1
    )
    solved = np.linalg.solve(r, right)
    solved[lost] = np.nan
    root = solved[..., 1:]
    return solved[..., 0], root @ np.swapaxes(root, 1, 2)


def _day_of_year(time: Array) -> Array:
    """1 at the beginning of the first of January of the log's first year."""
    first = GPS_EPOCH + timedelta(seconds=float(time.min()))
    start = first.replace(month=1, day=1, hour=0, minute=0, second=0, microsecond=0)
    return 1.0 + (time - (start - GPS_EPOCH).total_seconds()) / 86_400.0
