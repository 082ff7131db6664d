"""Satellites on Kepler orbits, seen in the earth-fixed (ECEF) frame (SPEC 4.3).

Times are GPS seconds since 1980-01-06 00:00 (no leap seconds), `gps_seconds` gives them.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from datetime import UTC, datetime

import numpy as np
import pymap3d
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# IS-GPS-200: the values that the broadcast orbits are fitted with.
GRAVITY = 3.986005e14  # m^3/s^2
EARTH_RATE = 7.2921151467e-5  # rad/s
SPEED_OF_LIGHT = 299_792_458.0  # m/s
WEEK = 604_800.0  # s
TYPICAL_FLIGHT = 0.076  # s: signals take 0.067 to 0.087
GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)


@dataclass(frozen=True, eq=False)
class Constellation:
    """K satellites; arrays (K,), radians, metres, seconds.

    Attributes:
        number: PRN, or the slot's place in a list.
        reference: GPS time to which the angles belong, s.
        semi_major_axis, eccentricity, inclination: of the orbit.
        node_longitude: of the ascending node in the earth-fixed frame at `reference`.
        node_rate: of the node in inertial space, rad/s.
        perigee, mean_anomaly: argument of perigee, and mean anomaly at `reference`.
        healthy: whether the satellite may be used.
    """

    number: NDArray[np.int64]
    reference: Array
    semi_major_axis: Array
    eccentricity: Array
    inclination: Array
    node_longitude: Array
    node_rate: Array
    perigee: Array
    mean_anomaly: Array
    healthy: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.number)

    def usable(self) -> Constellation:
        """The healthy satellites alone."""
        return Constellation(*(getattr(self, item.name)[self.healthy] for item in fields(self)))

    def states(self, time: ArrayLike) -> tuple[Array, Array]:
        """Positions and velocities (..., K, 3) in the earth-fixed frame at GPS times (..., K).

        The velocity is the rate of the earth-fixed coordinates. Times (..., 1) serve all.
        """
        since = np.asarray(time, dtype=float) - self.reference
        motion = np.sqrt(GRAVITY / self.semi_major_axis**3)
        eccentric = eccentric_anomaly(self.mean_anomaly + motion * since, self.eccentricity)
        root = np.sqrt(1.0 - self.eccentricity**2)
        sine, cosine = np.sin(eccentric), np.cos(eccentric)
        radius = self.semi_major_axis * (1.0 - self.eccentricity * cosine)
        speed = motion * self.semi_major_axis**2 / radius
        # In the orbit's plane, x through perigee; then turned by the argument of perigee.
        flat = (
            self.semi_major_axis * (cosine - self.eccentricity),
            self.semi_major_axis * root * sine,
        )
        flat_rate = -speed * sine, speed * root * cosine
        sine, cosine = np.sin(self.perigee), np.cos(self.perigee)
        x, y = cosine * flat[0] - sine * flat[1], sine * flat[0] + cosine * flat[1]
        vx, vy = (
            cosine * flat_rate[0] - sine * flat_rate[1],
            sine * flat_rate[0] + cosine * flat_rate[1],
        )
        turning = self.node_rate - EARTH_RATE
        node = self.node_longitude + turning * since
        sine, cosine = np.sin(node), np.cos(node)
        up, level = np.sin(self.inclination), np.cos(self.inclination)
        position = np.stack(
            (cosine * x - sine * level * y, sine * x + cosine * level * y, up * y), -1
        )
        velocity = np.stack(
            (
                cosine * vx - sine * level * vy - turning * position[..., 1],
                sine * vx + cosine * level * vy + turning * position[..., 0],
                up * vy,
            ),
            -1,
        )
        return position, velocity

    def seen_from(self, receiver: Array, time: Array) -> tuple[Array, Array]:
        """What a receiver at (..., 3) uses at reception times (...): states (..., K, 3).

        Where the satellites were when the signal left, in the earth-fixed frame of the
        reception (the earth turns by up to 140 m under a signal in flight). With that
        the geometric range is the plain distance. Its rate from these velocities
        leaves out the change of the flight time, 1 cm/s at most.
        """
        time, receiver = np.asarray(time)[..., None], receiver[..., None, :]
        flight = np.full(1, TYPICAL_FLIGHT)
        for _ in range(2):  # each pass gains five digits: a millimetre
            position, velocity = self.states(time - flight)
            position = turned_with_earth(position, flight)
            flight = np.linalg.norm(position - receiver, axis=-1) / SPEED_OF_LIGHT
        return position, turned_with_earth(velocity, flight)


def eccentric_anomaly(mean_anomaly: Array, eccentricity: Array) -> Array:
    """Solve Kepler's equation E - e sin E = M by Newton's method, to rounding for e < 0.1."""
    if not np.any(eccentricity):  # of circles there is nothing to solve
        return mean_anomaly
    eccentric = mean_anomaly + eccentricity * np.sin(mean_anomaly)
    for _ in range(3):
        residual = eccentric - eccentricity * np.sin(eccentric) - mean_anomaly
        eccentric = eccentric - residual / (1.0 - eccentricity * np.cos(eccentric))
    return eccentric


def turned_with_earth(vector: Array, duration: Array) -> Array:
    """Earth-fixed vectors (..., 3) in the earth-fixed frame `duration` (...) seconds later."""
    sine, cosine = np.sin(EARTH_RATE * duration), np.cos(EARTH_RATE * duration)
    x, y, z = np.moveaxis(vector, -1, 0)
    return np.stack((cosine * x + sine * y, cosine * y - sine * x, z + 0.0 * sine), -1)


def look_angles(receiver: Array, satellite: Array) -> tuple[Array, Array]:
    """Elevation and azimuth (clockwise from north) of satellites (..., K, 3) from (..., 3), rad."""
    latitude, longitude, height = geodetic(receiver[..., None, :])
    azimuth, elevation, _ = pymap3d.ecef2aer(
        *np.moveaxis(satellite, -1, 0), latitude, longitude, height, deg=False
    )
    return np.asarray(elevation), np.asarray(azimuth)


def geodetic(position: Array) -> tuple[Array, Array, Array]:
    """WGS84 latitude and longitude (rad) and height (m) of earth-fixed positions (..., 3)."""
    place = pymap3d.ecef2geodetic(*np.moveaxis(position, -1, 0), deg=False)
    latitude, longitude, height = (np.reshape(value, position.shape[:-1]) for value in place)
    return latitude, longitude, height


def earth_fixed(states: Array, place: tuple[float, float, float]) -> Array:
    """States of an east-north-up frame in the earth-fixed one.

    Args:
        states: (..., 9) of `kfenv.models.kinematics`, SI.
        place: latitude and longitude (deg) and height (m) of the frame's origin.
    """
    rotation = np.array(pymap3d.enu2uvw(*np.eye(3), place[0], place[1]))
    turned, origin = np.empty(states.shape), pymap3d.geodetic2ecef(*place)
    for order in range(3):  # position, velocity, acceleration
        east, north, up = (np.ascontiguousarray(states[..., 3 * i + order]) for i in range(3))
        for axis, (x, y, z) in enumerate(rotation):
            turned[..., 3 * axis + order] = x * east + y * north + z * up + 0.0  # nothing is -0
    turned[..., ::3] += origin
    return turned


def gps_seconds(date: datetime) -> float:
    """GPS time of a date, itself in GPS time (one without a time zone counts as such)."""
    if date.tzinfo is None:
        date = date.replace(tzinfo=UTC)
    return (date - GPS_EPOCH).total_seconds()
