"""All that can be tried, by name."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from kfenv.names import unknown

from .environments import Environments
from .filters import Banks, Designs, Engines
from .folders import KINDS, Folders
from .readers import READERS, SAMPLES, Files
from .subject import Subject

GROUPS = {
    "filters": ("engine", "designs", "banks"),
    "readers": tuple(READERS),
    "folders": tuple(KINDS),
}
SUBJECTS: dict[str, Callable[[Path], Subject]] = {
    **{kind.name: lambda samples, kind=kind: kind() for kind in (Engines, Designs, Banks)},
    Environments.name: lambda samples: Environments(),
    **{name: partial(Files, name) for name in READERS},
    **{name: lambda samples, name=name: Folders(name) for name in KINDS},
}


def make_subjects(names: tuple[str, ...] = (), samples: Path = SAMPLES) -> list[Subject]:
    """The subjects of these names or groups, or all; each once.

    Args:
        samples: folder of valid files for the readers, laid out as the one that is the default.

    Raises:
        ValueError: if there is none of a name, or no files for it.
    """
    for name in names:
        if name not in SUBJECTS and name not in GROUPS:
            raise ValueError(unknown("subject", name, (*GROUPS, *SUBJECTS)))
    wanted = [one for name in names or tuple(SUBJECTS) for one in GROUPS.get(name, (name,))]
    return [SUBJECTS[name](samples) for name in dict.fromkeys(wanted)]
