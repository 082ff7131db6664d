"""Imports point downwards, nothing goes in circles, and modules stay short."""

import ast
import tomllib
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LONGEST = 400  # lines of a module

SHARED = {"kfenv", "kfenv.models"}
SCENARIOS = {f"kfenv.scenarios.{room}" for room in ("radar", "gnss", "inertial")}
LIBRARY = SHARED | SCENARIOS | {"kfenv.filters", "kfenv.scenarios", "kfenv.envs"}
AGENTS = LIBRARY | {"kfenv.agents", "kfenv.agents.jobs"}

# A layer or room, and which others it may import. What stands in a folder without a line of
# its own here belongs to the folder above.
MAY_IMPORT = {
    "kfenv": set(),
    "kfenv.models": {"kfenv"},
    "kfenv.filters": SHARED,
    "kfenv.scenarios": SHARED,
    **dict.fromkeys(SCENARIOS, SHARED | {"kfenv.scenarios"}),
    "kfenv.envs": LIBRARY,
    "kfenv.agents": LIBRARY,
    "kfenv.agents.jobs": LIBRARY | {"kfenv.agents"},
    "kfenv.agents.contestants": AGENTS,
    "kfenv.agents.contest": AGENTS | {"kfenv.agents.contestants"},
    "kfenv.agents.learning": AGENTS | {"kfenv.agents.contestants", "kfenv.agents.contest"},
    "kfenv.agents.deployment": AGENTS | {"kfenv.agents.contestants", "kfenv.agents.contest"},
    "kfenv.agents.running": AGENTS | {"kfenv.agents.contestants", "kfenv.agents.contest"},
    "kfenv.agents.reproduction": AGENTS,
    "kfenv.agents.tuning": AGENTS | {"kfenv.agents.contestants", "kfenv.agents.contest"},
    "kfenv.agents.fuzzing": AGENTS
    | {"kfenv.agents.contestants", "kfenv.agents.contest", "kfenv.agents.reproduction"},
}
MAY_IMPORT["kfenv.agents.cli"] = AGENTS | set(MAY_IMPORT)

TENSORS = "kfenv.models.namespaces.tensor"  # for models inside somebody's torch program


@cache
def sources():
    """The program: text of each module by its name, packages under the name of their folder."""
    found = {}
    for folder, package in ((ROOT / "kfenv", "kfenv"), (ROOT / "agents", "kfenv.agents")):
        for path in folder.rglob("*.py"):
            name = ".".join((package, *path.relative_to(folder).with_suffix("").parts))
            found[name] = path.read_text()
    return found


@cache
def imported(name, text):
    """Dotted names of all that a module imports, wherever in it."""
    found, folders = set(), name.split(".")
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = folders[: -node.level] if node.level else []
            origin = [*above, node.module] if node.module else above
            found |= {".".join([*origin, alias.name]) for alias in node.names}
    return found


def resolve(name, texts):
    """The module that a dotted name leads to, or the name where it is none of ours."""
    longer = name
    while longer:
        for module in (longer, f"{longer}.__init__"):
            if module in texts:
                return module
        longer = longer.rpartition(".")[0]
    return name


def graph(texts):
    return {
        name: {resolve(target, texts) for target in imported(name, text)}
        for name, text in texts.items()
    }


def layer(name):
    """The nearest folder upwards that has a line above."""
    folder = name.rpartition(".")[0]
    while folder not in MAY_IMPORT:
        folder = folder.rpartition(".")[0]
    return folder


def upward(texts):
    """Imports that go from a layer to one that it may not import."""
    return [
        f"{name} imports {target}"
        for name, targets in graph(texts).items()
        for target in sorted(targets & set(texts))
        if layer(target) not in MAY_IMPORT[layer(name)] | {layer(name)}
    ]


def circle(texts):
    """The first circle of imports: the modules on it, none if there is none."""
    try:
        TopologicalSorter(graph(texts)).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def learning(texts):
    """Modules of kfenv proper that import its agents, torch, or what needs torch."""
    return [
        f"{name} imports {target}"
        for name, targets in graph(texts).items()
        for target in sorted(targets)
        if not name.startswith("kfenv.agents.") and name != TENSORS
        if target == TENSORS or target.startswith(("kfenv.agents.", "torch"))
    ]


def long(texts):
    return [name for name, text in texts.items() if len(text.splitlines()) > LONGEST]


def untold(texts):
    """Packages that do not say what lives there."""
    packages = {name.rpartition(".")[0] for name in texts}
    inits = {package: texts.get(f"{package}.__init__", "") for package in packages}
    return [package for package, text in inits.items() if not ast.get_docstring(ast.parse(text))]


def left_at_home(texts):
    """Packages that an installation would lack, and those that it would look for in vain."""
    told = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    return sorted({name.rpartition(".")[0] for name in texts} ^ set(told))


@pytest.mark.parametrize("offences", [upward, circle, learning, long, untold, left_at_home])
def test_the_house_is_in_order(offences):
    assert offences(sources()) == []


@pytest.mark.parametrize(
    ("offences", "place", "planted"),
    [
        (upward, "kfenv.filters.results", "from kfenv.scenarios.recording import Recording"),
        (upward, "kfenv.scenarios.recording", "import kfenv.filters.results"),
        (upward, "kfenv.scenarios.recording", "from kfenv.scenarios.radar import tracking"),
        (upward, "kfenv.scenarios.gnss.log", "from kfenv.scenarios.inertial.log import read_log"),
        (upward, "kfenv.models.model", "def late():\n    from kfenv.envs import knobs"),
        (upward, "kfenv.names", "import kfenv.models.model"),
        (upward, "kfenv.agents.files", "from .cli import app"),
        (upward, "kfenv.agents.contestants.agent", "from ..contest.rollout import rollout"),
        (upward, "kfenv.agents.contest.rollout", "from ..learning import training"),
        (upward, "kfenv.agents.reproduction.bounds", "from ..contest import rollout"),
        (circle, "kfenv.filters.results", "def late():\n    import kfenv.filters.replay"),
        (circle, "kfenv.agents.contestants.agent",
         "if TYPE_CHECKING:\n    from .family import FamilyFilter"),
        (learning, "kfenv.envs.core", "import torch.nn"),
        (learning, "kfenv.envs.core", "from kfenv.agents.contest.rollout import rollout"),
        (learning, "kfenv.filters.reference", "from kfenv.models.namespaces import tensor"),
        (long, "kfenv.filters.results", "\n" * LONGEST),
    ],
)  # fmt: skip
def test_disorder_is_seen(offences, place, planted):
    texts = dict(sources())
    texts[place] += f"\n{planted}\n"
    assert place in str(offences(texts))


@pytest.mark.parametrize("package", ["kfenv.filters", "kfenv.agents.contest"])
def test_a_room_without_a_word_is_seen(package):
    texts = dict(sources())
    texts[f"{package}.__init__"] = ""
    assert untold(texts) == [package]
    del texts[f"{package}.__init__"]
    assert untold(texts) == [package]
