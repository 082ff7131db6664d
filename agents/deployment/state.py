"""The state of a tuned filter as a file of plain arrays, and an agent's as arrays by name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..contestants.agent import Agent
from ..contestants.policy_file import read_arrays, write_arrays

FORMAT = "kfenv-state-1"
OF_AGENT = "agent."  # begins the names of an agent's arrays


def write_state(path: Path, owner: str, arrays: Mapping[str, NDArray], agent: Agent) -> None:
    """Write arrays and an agent's state, whole or not at all.

    Args:
        path: of the file.
        owner: in words, whose state it is.
        arrays: by name.
        agent: whose private attributes are its state.

    Raises:
        ValueError: if the agent's state is more than arrays.
    """
    write_arrays(path, {"format": FORMAT, "owner": owner, **arrays, **arrays_of(agent)})


def read_state(path: Path, owner: str, arrays: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """What `write_state` wrote, checked against arrays of the same names.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is none, is damaged, or another owner's.
    """
    try:
        found = read_arrays(path)
        form, whose = str(found.pop("format")), str(found.pop("owner"))
    except FileNotFoundError:
        raise
    except Exception as error:  # a damaged archive can fail in any of its readers
        raise ValueError(f"{path} is no state of a TunedFilter, or is damaged: {error}") from error
    if form != FORMAT or whose != owner:
        raise ValueError(f"{path} holds the state of {whose}, and this is {owner}.")
    own = {name: array for name, array in found.items() if not name.startswith(OF_AGENT)}
    if _shapes(own) != _shapes(arrays):
        raise ValueError(f"{path} is damaged: its arrays are not those of {owner}.")
    return found


def arrays_of(agent: Agent) -> dict[str, NDArray]:
    """What an agent holds of its episodes: the arrays in its private attributes, by name.

    Raises:
        ValueError: if it holds what is neither an array nor constant.
    """
    found = {}
    for name, value in _private(agent):
        for key, array in _leaves(name, value):
            if not isinstance(array, np.ndarray):
                raise ValueError(
                    f"The agent {agent.name} holds {name[1:]}, a {type(array).__name__}, which is "
                    "no array: its state cannot be saved."
                )
            found[OF_AGENT + key] = array
    return found


def restore(agent: Agent, arrays: Mapping[str, NDArray]) -> None:
    """Give an agent that begins what `arrays_of` found in another.

    Raises:
        ValueError: if the arrays are not an agent's of its kind.
    """
    for name, value in _private(agent):
        setattr(agent, name, _rebuilt(name, value, arrays))


def _private(agent: Agent) -> list[tuple[str, Any]]:
    return [(name, value) for name, value in vars(agent).items() if name.startswith("_")]


def _leaves(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """The parts of a value that may change: not what is frozen, and none of a value yet to come."""
    if isinstance(value, tuple):
        for i, part in enumerate(value):
            yield from _leaves(f"{name}.{i}", part)
    elif isinstance(value, bool | int | float):
        yield name, np.asarray(value)
    elif value is not None and not _is_frozen(value):
        yield name, value


def _rebuilt(name: str, value: Any, arrays: Mapping[str, NDArray]) -> Any:
    if isinstance(value, tuple):
        parts = [_rebuilt(f"{name}.{i}", part, arrays) for i, part in enumerate(value)]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    key = OF_AGENT + name
    if value is None:
        return arrays[key].copy() if key in arrays else None
    if _is_frozen(value):
        return value
    if key not in arrays or arrays[key].shape != np.shape(value):
        raise ValueError(f"the state has no {name[1:]} of the shape {np.shape(value)}")
    found = arrays[key].copy()
    return found if isinstance(value, np.ndarray) else type(value)(found)


def _is_frozen(value: Any) -> bool:
    parameters = getattr(type(value), "__dataclass_params__", None)
    return parameters is not None and parameters.frozen


def _shapes(arrays: Mapping[str, NDArray]) -> dict[str, Any]:
    return {name: (array.shape, array.dtype) for name, array in arrays.items()}
