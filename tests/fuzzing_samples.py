"""Writes the small valid files that `kfenv fuzz` spoils: ``python tests/fuzzing_samples.py``.

All is simulated: a flight's reports, a drive's GNSS and inertial logs, the baseline constellation
as an almanac, and untrained policies.
"""

import tempfile
from pathlib import Path

import moving_receivers
import numpy as np
from disordered_flights import reports
from inertial_logs import car
from kfenv.agents.contestants.policy import FORMER_FORMAT, write_policy
from kfenv.agents.contestants.policy_file import write_arrays
from moving_receivers import ALPHA, BETA, calendar, drive, write_truth
from plot_files import of_episode, truth_of
from policies import about, random_arrays
from rinex_files import header_line

from kfenv.models.gnss.almanac import baseline_constellation
from kfenv.models.gnss.orbits import EARTH_RATE, WEEK
from kfenv.scenarios.gnss.rinex import read_observations
from kfenv.scenarios.inertial.files import GNSS_COLUMNS, IMU_COLUMNS, TRUTH_COLUMNS
from kfenv.scenarios.radar.tracking import RadarTracking

SAMPLES = Path(__file__).parents[1] / "agents" / "fuzzing" / "samples"


def write_tracks(folder):
    """Reports every four seconds in metres; some of them out of order, in feet."""
    track = reports(stamps="whole", late=0.05, stale=0.02)
    rows = np.column_stack((track.time, track.latitude, track.longitude, track.altitude))[40:140]
    save(folder / "flight.csv", rows, ("t", "lat", "lon", "alt_m"), "%.6f")
    feet = np.column_stack((rows[:, 3] / 0.3048, rows[:, :3], np.arange(len(rows))))
    save(folder / "feet.csv", feet[::-1][::2], ("alt_ft", "t", "lat", "lon", "squawk"), "%.6f")


def write_plots(folder):
    """Plots of a simulated flight twice a second, with gaps and deviations, and its truth."""
    scenario = RadarTracking(rate=2.0, duration=60.0)
    episode = scenario.sample([np.random.default_rng(2)])
    of_episode(folder / "plots.csv", scenario.sensor, episode, "%.8g")
    truth_of(folder / "truth.csv", episode, "%.8g")


def write_rinex(folder):
    """A drive in RINEX 3 with two systems, its truth in two forms; one at rest in RINEX 2."""
    found = drive(folder, "GE", duration=150.0, interval=6.0)
    for name, style in (("truth.csv", "week"), ("truth.pos", "pos")):
        write_truth(folder / name, found, style)
    moving_receivers.way = lambda time: np.zeros((len(time), 3))
    with tempfile.TemporaryDirectory() as place:
        still = drive(Path(place), "G", duration=150.0, interval=6.0)
        write_rinex_2(folder / "static.05o", read_observations(still.observed), still.position[0])
        write_navigation_2(folder / "static.05n", still.broadcast.read_text().splitlines())


def write_rinex_2(path, seen, position):
    """Observations of GPS in RINEX 2; of a receiver at rest, so far as its header says."""
    text = header_line("     2.10           OBSERVATION DATA    G", "RINEX VERSION / TYPE")
    text += header_line("".join(f"{x:14.4f}" for x in position), "APPROX POSITION XYZ")
    text += header_line("     3    C1    D1    S1", "# / TYPES OF OBSERV") + header_line(
        "", "END OF HEADER"
    )
    tables = (seen.pseudorange, seen.doppler, seen.strength)
    for time, *rows in zip(seen.time, *tables, strict=True):
        there = np.flatnonzero(np.isfinite(rows[0]))[:12]
        date = calendar(np.floor(time)).split()
        when = " ".join(f"{int(field):2d}" for field in (date[0][2:], *date[1:5]))
        second = int(date[5]) + time % 1.0
        names = "".join(f"G{prn:02d}" for prn in seen.satellite[there])
        text += f" {when}{second:11.7f}  0{len(there):3d}{names}\n"
        for i in there:
            text += "".join(f"{row[i]:14.3f}  " for row in rows).rstrip() + "\n"
    path.write_text(text)


def write_navigation_2(path, lines):
    """The ephemerides of GPS of a RINEX 3 file in RINEX 2."""
    text = header_line("     2.10           N: GPS NAV DATA", "RINEX VERSION / TYPE")
    for values, label in ((ALPHA, "ION ALPHA"), (BETA, "ION BETA")):
        text += header_line("  " + "".join(f"{value:12.4e}" for value in values), label)
    text += header_line("", "END OF HEADER")
    for start in (i for i, line in enumerate(lines) if line.startswith("G") and line[3] == " "):
        first, *others = lines[start : start + 8]
        if first[:4] != "GPSA" and first[:4] != "GPSB":
            year, month, day, hour, minute, second = first[4:23].split()
            text += f"{int(first[1:3]):2d} {year[2:]} {int(month):2d} {int(day):2d} {int(hour):2d}"
            text += f" {int(minute):2d}{float(second):5.1f}{first[23:]}\n"
            text += "".join(f"{line[1:]}\n" for line in others)
    path.write_text(text.replace("e", "D"))


def write_almanac(path):
    """The baseline constellation, one satellite of it sick."""
    sky, text = baseline_constellation(), ""
    for k in range(len(sky)):
        text += f"******** Week 703 almanac for PRN-{sky.number[k]:02d} ********\n"
        applies = sky.reference[k] % WEEK
        for key, value in (
            ("ID", f"{sky.number[k]:02d}"),
            ("Health", "063" if k == 5 else "000"),
            ("Eccentricity", f"{sky.eccentricity[k]:.10E}"),
            ("Time of Applicability(s)", f"{applies:.4f}"),
            ("Orbital Inclination(rad)", f"{sky.inclination[k]:.10f}"),
            ("Rate of Right Ascen(r/s)", f"{sky.node_rate[k]:.10E}"),
            ("SQRT(A)  (m 1/2)", f"{sky.semi_major_axis[k] ** 0.5:.6f}"),
            (
                "Right Ascen at Week(rad)",
                f"{np.angle(np.exp(1j * (sky.node_longitude[k] + EARTH_RATE * applies))):.10E}",
            ),
            ("Argument of Perigee(rad)", f"{sky.perigee[k]:.9f}"),
            ("Mean Anom(rad)", f"{np.angle(np.exp(1j * sky.mean_anomaly[k])):.10E}"),
            ("Af0(s)", "0.0000000000E+00"),
            ("Af1(s/s)", "0.0000000000E+00"),
            ("week", "703"),
        ):
            text += f"{key + ':':<27s}{value}\n"
        text += "\n"
    path.write_text(text)


def write_inertial(folder):
    """A drive at 10 Hz; the fixes once more as RTKLIB's solution."""
    log, _ = car(40.0, 10.0, 5)
    save(folder / "imu.csv", log.imu, IMU_COLUMNS, "%.3f" + 6 * ",%.5f")
    save(folder / "gnss.csv", log.gnss, GNSS_COLUMNS, "%.3f,%.9f,%.9f,%.3f" + 9 * ",%.3f")
    save(folder / "truth.csv", log.truth[::2], TRUTH_COLUMNS, "%.3f,%.9f,%.9f" + 4 * ",%.4f")
    names = ("Q", "ns", "sdn(m)", "sde(m)", "sdu(m)", "vn(m/s)", "ve(m/s)", "vu(m/s)", "sdvn",
             "sdve", "sdvu")  # fmt: skip
    text = "%  GPST  latitude(deg) longitude(deg)  height(m)  " + " ".join(names) + "\n"
    for t, *row in log.gnss:
        place, (north, east, down), deviation = row[:3], row[3:6], row[6:]
        values = [*deviation[:3], north, east, -down, *deviation[3:]]
        text += f"2129 {t:.3f} {place[0]:.9f} {place[1]:.9f} {place[2]:.4f} 1 9 "
        text += " ".join(f"{value:.4f}" for value in values) + "\n"
    (folder / "fixes.pos").write_text(text)


def write_policies(folder):
    """One of each kind of network, and one in the former format."""
    for kind in ("gru", "mlp-log-factors"):
        write_policy(folder / f"{kind}.npz", random_arrays(kind, hidden=4), about())
    rng = np.random.default_rng(0)
    arrays = {"algorithm": "ppo", "activation": "tanh", "layers": 2, "low": -np.ones(3, "f4"),
              "high": np.ones(3, "f4")}  # fmt: skip
    for layer, shape in enumerate(((9, 4), (4, 3))):
        arrays[f"weight_{layer}"] = rng.standard_normal(shape).astype("f4")
        arrays[f"bias_{layer}"] = rng.standard_normal(shape[1]).astype("f4")
    write_policy(folder / "mlp.npz", arrays | {"kind": "mlp"}, about())
    told = {"format": FORMER_FORMAT, "env_id": "Nowhere-v0", "env_kwargs": "{}", "metadata": "{}"}
    write_arrays(folder / "former.npz", arrays | told)


def save(path, table, names, form):
    form = form if "," in form else ",".join([form] * len(names))
    path.write_text("\n".join([",".join(names), *(form % tuple(row) for row in table)]) + "\n")


if __name__ == "__main__":
    for name, write in (
        ("tracks", write_tracks), ("plots", write_plots), ("rinex", write_rinex),
        ("ins", write_inertial),
        ("policies", write_policies), ("almanac", lambda f: write_almanac(f / "baseline.yuma")),
    ):  # fmt: skip
        (SAMPLES / name).mkdir(parents=True, exist_ok=True)
        write(SAMPLES / name)
