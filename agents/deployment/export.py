"""A policy leaves for another system, with a contract that says what it expects."""

from __future__ import annotations

from pathlib import Path

from kfenv.names import unknown

from ..files import write_json, written_whole
from .c_source import c_files
from .contract import contract, page
from .deployable import Deployable
from .onnx_file import onnx_model

FORMS = ("onnx", "c", "npz")


def export_policy(deployable: Deployable, form: str, folder: Path) -> list[Path]:
    """Write a policy in one of the forms, and its contract, and return the files' paths.

    Raises:
        ValueError: if the form is unknown or cannot hold the policy, or a package is missing.
    """
    told = contract(deployable)
    if form == "onnx":
        files = {"policy.onnx": onnx_model(deployable, told)}
    elif form == "c":
        files = {name: text.encode() for name, text in c_files(deployable).items()}
    elif form == "npz":
        files = {"policy.npz": deployable.content}
    else:
        raise ValueError(unknown("form", form, FORMS))
    files["contract.md"] = page(told).encode()
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        with written_whole(folder / name) as file:
            file.write(content)
    write_json(folder / "contract.json", told)
    return [folder / name for name in (*files, "contract.json")]
