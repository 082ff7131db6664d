"""The parameters of an agent that an earlier command has tuned, from the folder that it left."""

from __future__ import annotations

from pathlib import Path

from ..contest.scores import read_values, scores_path
from ..files import read_json

STATIC = "fixed-tuned"  # the agent that holds static noise
REMEDY = "tune it again"


def tuned_values(folder: Path, agent: str) -> dict[str, float]:
    """What `kfenv evaluate` or `kfenv tune` chose for an agent, by the parameters' names.

    The static noise of `kfenv tune`, a factor for each knob, is for ``fixed-tuned``.

    Raises:
        ValueError: if the folder holds nothing of that agent, or is damaged.
    """
    report = folder / "report.json"
    if not report.exists():
        if not scores_path(folder, agent).exists():
            raise ValueError(f"{folder} holds nothing of {agent}: tune it there first.")
        return read_values(folder, agent)
    told = read_json(report, dict, REMEDY)
    if agent == STATIC:
        chosen = told["static"][told["by"][0]]["parameters"]
        return {name: parameter["value"] for name, parameter in chosen.items()}
    for rule in told["rules"]:
        if rule["name"] == agent:
            return dict(rule["values"])
    names = [STATIC, *(rule["name"] for rule in told["rules"])]
    raise ValueError(f"{folder} tells nothing of {agent}, but of {', '.join(names)}.")
