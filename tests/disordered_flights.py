"""A simulated flight from the stand to cruise, and its reports with what spoils recorded ones."""

import numpy as np
import pymap3d

from kfenv.scenarios.reports import Track

PLACE = (45.0, 5.0, 100.0)
# Until a time: acceleration along the track, turn rate in deg/s, climb in m/s
PHASES = (
    (60.0, 0.0, 0.0, 0.0),  # it stands
    (65.0, 1.0, 0.0, 0.0),
    (200.0, 0.0, 0.0, 0.0),  # it taxies
    (230.0, 2.5, 0.0, 0.0),  # it takes off
    (300.0, 0.5, 0.0, 10.0),
    (360.0, 0.0, 2.5, 10.0),
    (500.0, 0.5, 0.0, 12.0),
    (560.0, 0.0, -1.5, 8.0),
    (650.0, 0.3, 0.0, 8.0),
    (1600.0, 0.0, 0.0, 0.0),
    (1640.0, 0.0, 1.0, 0.0),
    (2000.0, 0.0, 0.0, -6.0),
)
CRUISE = (700.0, 1500.0)


def true_position(time):
    """East, north and up of the place (T, 3) at these times, m; straight on after the end."""
    fine = np.arange(-5.0, PHASES[-1][0] + 20.0, 0.05)
    row = np.searchsorted([phase[0] for phase in PHASES[:-1]], fine, side="right")
    along, rate, climb = np.array(PHASES)[row, 1:].T
    speed = np.cumsum(along) * 0.05
    heading = np.radians(30.0 + np.cumsum(rate) * 0.05)
    velocity = np.stack((speed * np.sin(heading), speed * np.cos(heading), climb))
    place = np.cumsum(velocity, axis=1) * 0.05
    return np.stack([np.interp(time, fine, axis) for axis in place], axis=-1)


def report_times(density):
    """Every second or four, or four at the ends and sixty in cruise, s."""
    if density != "mixed":
        return np.arange(0.0, PHASES[-1][0], float(density))
    ends = np.arange(0.0, CRUISE[0], 4.0), np.arange(CRUISE[1], PHASES[-1][0], 4.0)
    return np.concatenate((ends[0], np.arange(*CRUISE, 60.0), ends[1]))


def reports(density="4", stamps="exact", late=0.0, stale=0.0, jitter=3.0, seed=0):
    """The flight as it is recorded.

    Args:
        density: of the reports, see `report_times`.
        stamps: "exact", or "whole" seconds.
        late: share of the reports that are stamped up to 3 s late.
        stale: share that repeat the position before.
        jitter: of the positions, m.
    """
    rng = np.random.default_rng(seed)
    exact = report_times(density) + rng.uniform(0.0, 1.0)
    exact = exact + rng.uniform(0.0, 1.0, exact.size)
    place = true_position(exact) + jitter * rng.standard_normal((exact.size, 3)) * (1, 1, 0.3)
    time = np.floor(exact) if stamps == "whole" else exact
    time = time + np.where(rng.random(exact.size) < late, rng.uniform(1.0, 3.0, exact.size), 0.0)
    latitude, longitude, altitude = pymap3d.enu2geodetic(*place.T, *PLACE)
    for i in 1 + np.flatnonzero(rng.random(exact.size - 1) < stale):
        latitude[i], longitude[i] = latitude[i - 1], longitude[i - 1]
    order = np.argsort(time, kind="stable")
    return Track(*(v[order] for v in (time, latitude, longitude, altitude)))


def error(time, position):
    """RMS distance of positions (N, 3) from the truth, but for their mean delay, m."""
    slope = true_position(time + 0.5) - true_position(time - 0.5)
    fast = np.linalg.norm(slope, axis=1) > 30.0
    off = np.sum((true_position(time) - position) * slope, axis=1)[fast]
    delay = np.median(off / np.sum(slope * slope, axis=1)[fast])
    return np.sqrt(np.mean(np.sum((position - true_position(time - delay)) ** 2, axis=1)))
