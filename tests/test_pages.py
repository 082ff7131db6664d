"""The docstring of every environment is its page: all headings, arguments, knobs, features.

Every figure is the code's: shared paragraphs are filled from it, and those few that an
environment's own text types are held against it here.
"""

import dataclasses
import inspect
import re

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import load_env_creator
from rollouts import GNSS, INERTIAL, OWN, TRACKING, VALIDATION, every_environment, make

from kfenv.envs.options import REWARDS, Options
from kfenv.envs.pages import compose, with_page
from kfenv.envs.rewards import CAP
from kfenv.envs.statistics import WINDOWS
from kfenv.envs.wording import WIDTH, wrap
from kfenv.models.gnss.receiver import range_deviation
from kfenv.models.strapdown import GRAVITY
from kfenv.scenarios import coverage
from kfenv.scenarios.inertial.flights import PERIOD, TURN_SPEED
from kfenv.scenarios.radar.tracking import RadarTracking
from kfenv.scenarios.radar.validation import PUBLISHED_NOISE
from kfenv.scenarios.trajectories import paper_trajectory
from kfenv.scenarios.windows import PARTS

HEADINGS = [
    "Description", "Action Space", "Observation Space", "Rewards", "Starting State",
    "Episode End", "Arguments", "Version History",
]  # fmt: skip


def page(env_id: str) -> str:
    return inspect.getdoc(type(gym.make(env_id).unwrapped))


def section(env_id: str, heading: str) -> str:
    return re.split(r"^## ", page(env_id).split(f"## {heading}\n")[1], flags=re.M)[0]


def flat(env_id: str) -> str:
    return " ".join(page(env_id).split())


def vector_class(env_id: str) -> type:
    return load_env_creator(gym.spec(env_id).vector_entry_point)


def argument(env_id: str, name: str) -> str:
    entries = re.split(r"^- (?=``\w+``:)", section(env_id, "Arguments"), flags=re.M)
    return next(" ".join(e.split()) for e in entries if e.startswith(f"``{name}``:"))


@every_environment
def test_headings(env_id):
    assert re.findall(r"^## (.*)$", page(env_id), re.M) == HEADINGS


@every_environment
def test_every_argument_is_there(env_id):
    told = re.findall(r"^- ``(\w+)``:", section(env_id, "Arguments"), re.M)
    scenario = make(env_id).scenario
    fields = [*dataclasses.fields(scenario), *dataclasses.fields(Options)]
    assert sorted(told) == sorted({"render_mode", *(field.name for field in fields)})


@every_environment
def test_the_tables_are_those_of_the_spaces(env_id):
    core = make(env_id).core
    rows = re.findall(r"^\| (\w+) +\| (\S+) to (\S+) +\|", section(env_id, "Action Space"), re.M)
    assert [(name, float(low), float(high)) for name, low, high in rows] == [
        (knob.name, knob.low, knob.high) for knob in core.knobs
    ]
    table = re.findall(r"^\| (\d[\d, to]*?) +\|", section(env_id, "Observation Space"), re.M)
    places = [int(place) for cell in table for place in cell.split(", ") if "to" not in cell]
    size, knobs = core.observation_size, len(core.knobs)
    assert sorted(places) == list(range(size - knobs))
    assert table[-1] == f"{size - knobs} to {size - 1}"
    assert str(make(env_id).action_space).startswith(f"Box(-1.0, 1.0, ({knobs},)")
    assert f"``Box(-1, 1, ({knobs},), float32)``" in section(env_id, "Action Space")
    assert f"``Box(float32)`` of {size} components" in section(env_id, "Observation Space")
    for window in WINDOWS:
        assert f"{window:g} arrivals" in section(env_id, "Observation Space")


@every_environment
def test_figures(env_id):
    scenario = gym.make(env_id).unwrapped.scenario
    assert f"error scale is {scenario.error_scale:g} m" in page(env_id)
    lost = f"position error above {scenario.lost_distance / 1e3:g} km"
    lost = f"scored error above {scenario.lost_distance:g} m" if env_id == OWN else lost
    assert lost in " ".join(section(env_id, "Episode End").split())
    most = {"rmse": scenario.lost_distance / scenario.error_scale, "improvement": CAP}
    for price in most.values():
        assert re.search(rf"\b{price:g}\b", section(env_id, "Rewards"))
    for name in REWARDS:
        assert f'``"{name}"``' in section(env_id, "Rewards")
    assert f"({len(scenario.time)} by default)" in page(env_id)
    for deviation, state in zip(scenario.initial_deviations, scenario.motion.states, strict=True):
        told, unit = (np.degrees(deviation), "deg") if state.angle else (deviation, state.unit)
        assert f"{told:.3g} {unit}" in section(env_id, "Starting State")
    for name in scenario.presets:
        assert f'``"{name}"``' in section(env_id, "Arguments")
    for name in scenario.known_faults:
        assert f"``{name}``" in section(env_id, "Arguments")


@every_environment
@pytest.mark.parametrize("what", ["num_envs", "autoreset_mode", "Sub-environment i"])
def test_the_vector_environment_has_a_page_too(env_id, what):
    assert what in inspect.getdoc(vector_class(env_id))


@every_environment
def test_defaults(env_id):
    scenario, options = gym.make(env_id).unwrapped.scenario, Options()
    for field in dataclasses.fields(scenario):
        value = getattr(scenario, field.name)
        told = argument(env_id, field.name)
        if isinstance(value, float):
            assert re.search(rf"\(default {value:g}[;)]|Default {value:g}[,;]", told), field.name
        elif isinstance(value, tuple):
            assert f"default {value}" in told
        elif field.name == "faults":
            assert re.search(rf'``"{value}"`` \(default', told)
    interval = scenario.steps_per_measurement
    assert re.search(rf"\(default {interval}\b", argument(env_id, "decision_interval"))
    assert f"(default {options.kappa:g})" in argument(env_id, "kappa")
    assert f'``"{options.filter}"`` (default' in argument(env_id, "filter")


@every_environment
def test_every_parameter_of_every_fault_is_there_with_its_default(env_id):
    told = argument(env_id, "faults")
    for name, fault in gym.make(env_id).unwrapped.scenario.known_faults.items():
        item = told.split(f"- ``{name}``:")[1].split(" - ")[0]
        assert re.findall(r"``(\w+)`` \(", item) == [
            field.name for field in dataclasses.fields(fault)
        ]
        for field in dataclasses.fields(fault):
            numbers = re.findall(
                r"[\d.]+(?:e-?\d+)?", item.split(f"``{field.name}`` (")[1].split(")")[0]
            )
            if isinstance(field.default, float | tuple):
                assert [float(number) for number in numbers] == pytest.approx(
                    np.ravel(field.default).tolist()
                )


@every_environment
def test_every_preset_names_its_faults(env_id):
    scenario = gym.make(env_id).unwrapped.scenario
    names = {fault: name for name, fault in scenario.known_faults.items()}
    for preset, faults in scenario.presets.items():
        item = argument(env_id, "faults").partition(f'- ``"{preset}"``')[2].split(" - ")[0]
        for fault in faults:
            assert f"``{names[type(fault)]}``" in item


@every_environment
def test_nothing_is_left_to_fill_in_or_to_wrap(env_id):
    for text in (page(env_id), inspect.getdoc(vector_class(env_id))):
        assert not re.search(r"\{\w", text)
        assert wrap(text) == text
        assert all(len(line) <= WIDTH for line in text.splitlines() if line[:1] != "|")
    assert page(env_id).splitlines()[0].endswith(".")  # which `kfenv envs` shows


@every_environment
def test_the_memory_of_an_episode(env_id):
    core = gym.make(env_id).unwrapped.core
    arrays = [*core._episode.values(), core._nominal_error]
    told = re.search(r"its\s+episode,\s+(\S+)\s+MB", inspect.getdoc(vector_class(env_id)))[1]
    assert float(told) == pytest.approx(sum(array.nbytes for array in arrays) / 1e6, rel=0.05)


def test_the_figures_that_are_typed():
    radar = RadarTracking().radar
    broadside = np.array([1e4]), np.zeros(1), np.full(1, radar.boresight_elevation)
    snr = radar.signal_to_noise(*broadside)
    distance, angle, _ = radar.noise(radar.integrated(snr), *broadside[1:])[0]
    assert f"{distance:.2f} m and {np.degrees(angle):.2f} deg at 10 km" in flat(TRACKING)
    for rate, word in ((10.0, "ten"), (2.0, "two")):
        told = "{:g} m, {:g} deg, {:g} deg".format(*PUBLISHED_NOISE[rate])
        assert f"{told} at {word}" in flat(VALIDATION)
    assert f"{TURN_SPEED:g} m/s, a bank of 45 deg" in flat(INERTIAL)
    assert f"and back in {PERIOD:g} s" in flat(INERTIAL)
    assert PARTS["validation"][1] == 0.5  # "next 20 %", "last half"
    for env_id in (GNSS, INERTIAL):
        assert f"first {100 * PARTS['tuning'][1]:g} %" in flat(env_id)


def test_the_places_that_are_typed():
    nearest, farthest = coverage.MIN_RANGE / 1e3, coverage.MAX_RANGE / 1e3
    broadside = np.degrees(coverage.MIN_ELEVATION + coverage.MAX_ELEVATION) / 2.0
    assert (
        f"({nearest:g} to {farthest:g} km, {np.degrees(coverage.MAX_AZIMUTH):g} deg off a "
        f"broadside {broadside:g} deg above north)" in flat(TRACKING)
    )
    time = np.arange(0.0, 250.0, 0.1)
    distance = np.linalg.norm(paper_trajectory("A", time)[:, ::3], axis=1)
    closest = f"approach {distance.min():.0f} m at {time[distance.argmin()]:.0f} s"
    assert closest in flat(VALIDATION)
    assert f"gravity {GRAVITY:.2f} m/s^2" in flat(INERTIAL)
    assert f"Their noise is {range_deviation(np.pi / 2.0):.0f} m and" in flat(GNSS)


def test_a_page_follows_the_code():
    class Other(RadarTracking):
        error_scale, lost_distance = 77.0, 3_000.0
        initial_deviation = (8.0, 9.0, 7.5)

    text = "Other.\n\n  {rewards}\n\n{episode_end}\n\n{initial_deviations}."
    text = " ".join(compose(text, Other).split())
    assert "The error scale is 77 m." in text
    assert "above 3 km" in text
    assert "8 m, 9 m/s and 7.5 m/s^2 per axis" in text


def test_a_paragraph_that_there_is_not_is_refused():
    class Env:
        """What. {raptures}"""

        scenario_class = RadarTracking

    with pytest.raises(KeyError, match="raptures"):
        with_page(Env)
