"""The docstring of every environment is its page: all headings, arguments, knobs, features."""

import dataclasses
import inspect
import re

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import load_env_creator
from rollouts import every_environment, make

from kfenv.envs.options import Options

HEADINGS = [
    "Description", "Action Space", "Observation Space", "Rewards", "Starting State",
    "Episode End", "Arguments", "Version History",
]  # fmt: skip


def page(env_id: str) -> str:
    return inspect.getdoc(type(gym.make(env_id).unwrapped))


def section(env_id: str, heading: str) -> str:
    return re.split(r"^## ", page(env_id).split(f"## {heading}\n")[1], flags=re.M)[0]


@every_environment
def test_headings(env_id):
    assert re.findall(r"^## (.*)$", page(env_id), re.M) == HEADINGS


@every_environment
def test_every_argument_is_there(env_id):
    told = re.findall(r"^- ``(\w+)``:", section(env_id, "Arguments"), re.M)
    scenario = make(env_id).scenario
    known = [field.name for field in [*dataclasses.fields(scenario), *dataclasses.fields(Options)]]
    assert sorted(told) == sorted([*known, "render_mode"])


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


@every_environment
def test_figures(env_id):
    scenario = gym.make(env_id).unwrapped.scenario
    assert f"error scale is {scenario.error_scale:g} m" in page(env_id)
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
    vector = load_env_creator(gym.spec(env_id).vector_entry_point)
    assert what in inspect.getdoc(vector)
