"""A made-up flight, and what the tests of tracks ask of states."""

import numpy as np
import pymap3d

from kfenv.scenarios.reports import Track

POSITION, VELOCITY, ACCELERATION = slice(0, 9, 3), slice(1, 9, 3), slice(2, 9, 3)
GRAVITY = 9.81


def turn_rate(states):
    vx, vy, ax, ay = states[:, 1], states[:, 4], states[:, 2], states[:, 5]
    return (vy * ax - vx * ay) / (vx**2 + vy**2)


def made_up(duration=300.0, step=1.0, jitter=0.0, seed=0):
    """A flight at 100 m/s and 1000 m whose turns of 1.5 deg/s swing with a period of 150 s."""
    time = np.arange(0.0, duration + 0.5 * step, step)
    omega = 2.0 * np.pi / 150.0
    heading = np.radians(1.5) / omega * (1.0 - np.cos(omega * time))
    fine = np.linspace(0.0, time[-1], 20 * time.size)
    direction = np.interp(fine, time, heading)
    travelled = [
        np.concatenate([[0.0], np.cumsum(100.0 * part(direction[:-1]) * np.diff(fine))])
        for part in (np.sin, np.cos)
    ]
    enu = np.array([np.interp(time, fine, part) for part in travelled] + [np.zeros(time.size)])
    enu += jitter * np.random.default_rng(seed).standard_normal(enu.shape)
    latitude, longitude, _ = pymap3d.enu2geodetic(*enu, 50.0, 5.0, 1000.0)
    return Track(time, latitude, longitude, 1000.0 + enu[2])
