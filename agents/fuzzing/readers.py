"""Readers: whatever a file holds, they give sound numbers or one sentence that names it."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Iterable
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.random import Generator, default_rng

from kfenv.models.gnss.almanac import read_yuma
from kfenv.models.radar import radar
from kfenv.scenarios.gnss.ephemeris import read_navigation, satellite_states
from kfenv.scenarios.gnss.reading import log_of
from kfenv.scenarios.gnss.rinex import read_observations
from kfenv.scenarios.gnss.tracking import GnssTracking
from kfenv.scenarios.inertial.files import read_fixes, read_imu
from kfenv.scenarios.inertial.ins_gnss import InsGnss
from kfenv.scenarios.positions import read_positions
from kfenv.scenarios.radar.plots import read_plots
from kfenv.scenarios.radar.tracking import RadarTracking
from kfenv.scenarios.reports import load_track
from kfenv.scenarios.tracks import flight, from_radar, window
from kfenv.scenarios.windows import PARTS

from ..contestants.policy import NumpyPolicy
from .mutations import mutate
from .subject import Case, Wrong

SAMPLES = Path(__file__).with_name("samples")
LONGEST = 600  # letters of a complaint's line
USED = 0.1  # share of the files that are made something of
DAY = datetime(2016, 2, 29)


class Reader(NamedTuple):
    """How a kind of file is read.

    Attributes:
        sets: patterns of the files that belong together, below a folder of samples; files of
            the same stem where there are several sets.
        read: takes their paths in that order, and complains of unsound results by `Wrong`.
        use: likewise makes something of them that takes longer.
    """

    sets: tuple[tuple[str, ...], ...]
    read: Callable[..., None]
    use: Callable[..., None] | None = None


class Files:
    """A reader, and valid files for it, of which one is spoilt in each case.

    Args:
        name: in `READERS`.
        folder: of samples, laid out as those that come with kfenv.

    Raises:
        ValueError: if it has none for this reader.
    """

    def __init__(self, name: str, folder: Path = SAMPLES) -> None:
        self.name = name
        self._sets = [s for patterns in READERS[name].sets for s in _found(folder, patterns)]
        if not self._sets:
            wanted = " or ".join(patterns[0] for patterns in READERS[name].sets)
            raise ValueError(f"The folder {folder} has no file for {name}: no {wanted}.")

    def draw(self, rng: Generator) -> Case:
        """See `Subject`."""
        paths = self._sets[rng.integers(len(self._sets))]
        contents = [path.read_bytes() for path in paths]
        spoilt = int(rng.integers(len(paths)))
        contents[spoilt] = mutate(rng, contents[spoilt])
        names = [path.name for path in paths]
        used = bool(rng.random() < USED)
        return {
            "names": names,
            "used": used,
            **{f"file {i}": one for i, one in enumerate(contents)},
        }

    def attempt(self, case: Case) -> int:
        """See `Subject`."""
        reader = READERS[self.name]
        with tempfile.TemporaryDirectory(prefix="kfenv-fuzz-") as place:
            paths = [Path(place) / name for name in case["names"]]
            for i, path in enumerate(paths):
                path.write_bytes(case[f"file {i}"])
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error", RuntimeWarning)
                    warnings.simplefilter("ignore", UserWarning)  # those are told to the user
                    reader.read(*paths)
                    if case["used"] and reader.use is not None:
                        reader.use(*paths)
            except ValueError as error:
                check_complaint(str(error), [path.name for path in paths])
        return 0


def check_complaint(said: str, names: Iterable[str]) -> None:
    """Complain of a complaint that does not say which file it is about, or says too much.

    Raises:
        Wrong: quoting it.
    """
    lines = said.splitlines()
    if not any(name in said for name in names):
        raise Wrong(f"a complaint names no file: {said[:200]}")
    if max(map(len, lines)) > LONGEST or len(lines) > 6:
        raise Wrong(f"a complaint is too long: {said[:200]}")
    if not said.isprintable() and not all(line.isprintable() for line in lines):
        raise Wrong(f"a complaint holds letters that cannot be printed: {said[:200]!r}")


def _found(folder: Path, patterns: tuple[str, ...]) -> list[tuple[Path, ...]]:
    """The sets of files: one for each that the first pattern finds."""
    sets = []
    for first in sorted(folder.glob(patterns[0])):
        others = [sorted(folder.glob(pattern)) for pattern in patterns[1:]]
        same = [[path for path in found if path.stem == first.stem] or found for found in others]
        if all(same):
            sets.append((first, *(found[0] for found in same)))
    return sets


# ----- the readers ------------------------------------------------------------------------


def _finite(what: str, *arrays: np.ndarray) -> None:
    if not all(np.isfinite(array).all() for array in arrays):
        raise Wrong(f"{what} not finite")


def _read_track(path: Path) -> None:
    track = load_track(path)
    _finite("reports are", track.time, track.latitude, track.longitude, track.altitude)


def _fly_track(path: Path) -> None:
    smooth = flight(path)
    ends = np.linspace(0.0, smooth.duration, 20)
    _finite("states of a flight are", smooth.states(ends), from_radar(smooth, smooth.origin, ends))
    short = np.arange(0.0, min(60.0, 0.5 * smooth.duration), 1.0)
    if len(short) > 1:
        _finite("a window is", window(default_rng(0), smooth, short))


def _read_plots(path: Path, *truth: Path) -> None:
    plots = read_plots(path, radar())
    _finite("times are", plots.time)
    _finite("plots are", np.nan_to_num(plots.value, nan=0.0))


def _replay_plots(*paths: Path) -> None:
    scenario = RadarTracking(duration=6.0, plots=tuple(map(str, paths)))
    scenario.sample([default_rng(0)])  # a Recording refuses what is not finite
    scenario.whole()


def _read_rinex(observations: Path, navigation: Path, *truth: Path) -> None:
    _finite("epochs are", read_observations(observations).time)
    sky = read_navigation(navigation)
    states = satellite_states(sky, np.arange(len(sky.time)), sky.time + 100.0)
    _finite("orbits are", *vars(states).values())
    for path in truth:
        _read_positions(path)


def _replay_rinex(*paths: Path) -> None:
    log = log_of(paths)
    for part in PARTS:
        log.recording(log.random_starts([default_rng(0)], 12.0, part), 12.0)


def _read_positions(path: Path) -> None:
    found = read_positions(path)
    _finite("positions are", found.time, found.position)


def _read_yuma(path: Path) -> None:
    sky = read_yuma(path, DAY)
    _finite("orbits are", *sky.states(sky.reference + 3600.0))


def _fly_yuma(path: Path) -> None:
    scenario = GnssTracking(duration=2.0, almanac=str(path))
    scenario.sample([default_rng(0)])  # a Recording refuses what is not finite


def _read_inertial(imu: Path, *fixes: Path) -> None:
    _finite("samples are", read_imu(imu).samples)
    for number, path in enumerate(fixes):
        found = read_fixes(path, truth=number > 0)
        _finite("fixes are", found.place, found.velocity)


def _replay_inertial(*paths: Path) -> None:
    scenario = InsGnss(duration=4.0, rate=10.0, log=tuple(map(str, paths)))
    scenario.sample([default_rng(0)])


def _read_policy(path: Path) -> None:
    policy = NumpyPolicy.load(path)
    if policy.observation_size > 10_000 or policy.network.memory_size > 10_000:
        raise Wrong("a policy is larger than its file")
    state = policy.start(3)
    for _ in range(2):
        seen = 10.0 * default_rng(0).standard_normal((3, policy.observation_size))
        action, state = policy.decide(seen, state)
    _finite("actions are", action)


READERS: dict[str, Reader] = {
    "tracks": Reader((("tracks/*.csv",),), _read_track, _fly_track),
    "plots": Reader(
        (("plots/plots*.csv", "plots/truth*.csv"), ("plots/plots*.csv",)),
        _read_plots,
        _replay_plots,
    ),
    "rinex": Reader(
        (
            ("rinex/*.obs", "rinex/*.nav", "rinex/*.pos"),
            ("rinex/*.obs", "rinex/*.nav", "rinex/*.csv"),
            ("rinex/*.??o", "rinex/*.??n"),
        ),
        _read_rinex,
        _replay_rinex,
    ),
    "positions": Reader((("rinex/*.csv",), ("rinex/*.pos",)), _read_positions),
    "almanac": Reader((("almanac/*.yuma",),), _read_yuma, _fly_yuma),
    "inertial": Reader(
        (("ins/imu*.csv", "ins/gnss*.csv", "ins/truth*.csv"), ("ins/imu*.csv", "ins/*.pos"),
         ("ins/imu*.csv", "ins/gnss*.csv")),
        _read_inertial,
        _replay_inertial,
    ),
    "policies": Reader((("policies/*.npz",),), _read_policy),
}  # fmt: skip
