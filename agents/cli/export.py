"""The command that takes a policy to another system."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .console import complaints, console
from .options import Option, env_kwargs


def export(
    policy: Annotated[
        str,
        typer.Argument(metavar="POLICY", help="A training folder, a policy.npz, or 'learned'."),
    ],
    to: Annotated[str, typer.Option(help="'onnx', 'c' or 'npz'.")],
    output: Annotated[Path, typer.Option(help="Folder for the policy and its contract.")],
    env: Annotated[
        str | None, typer.Option(help="An id that `kfenv envs` lists; 'learned' needs one.")
    ] = None,
    option: Option = None,
) -> None:
    """Write a trained policy for another system, with a contract that says what it expects.

    As ONNX, its memory is an input and an output. As C, the features are there too: your filter
    hands in innovation, covariance and told noise, and gets the knobs. contract.md and
    contract.json name every input, normalisation and knob.
    """
    with complaints():
        from ..deployment.deployable import Deployable
        from ..deployment.export import export_policy
        from ..files import is_free

        if not is_free(output):
            raise FileExistsError(f"The folder {output} is not empty: name another with --output.")

        kwargs = env_kwargs(None, None, None, None, option)
        for path in export_policy(Deployable.find(policy, env, **kwargs), to, output):
            console.print(f"{path}")
        if to == "c":
            console.print(
                f"To test it: cd {output} && cc -std=c99 -O3 kfenv_test.c kfenv_policy.c -lm "
                "-o kfenv_test && ./kfenv_test --bench"
            )
