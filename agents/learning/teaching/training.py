"""Trains a network by lessons from an agent that knows more, then through the filter.

The output folder holds

    config.json     all that is needed to repeat the run
    checkpoint.npz  network and optimiser as plain arrays, and how far the run has come
    policy.npz      the policy, for `kfenv.agents.contestants.policy`
    training.json   how far the run has come, and its course
    tensorboard/    the same for TensorBoard
    .lock           the id of the process that trains, while it does
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from threading import Event
from typing import Any

from ...contestants.agent import Agent, RecordingFilter
from ...contestants.learned import Learned
from ...contestants.registry import make_agent
from ...files import locked, write_json
from ..runs import TrainingInterrupted, admit, describe_run, stop_as_event, torch_threads
from ..settings import read_settings
from .course import Course, Curriculum
from .lessons import hold_lessons
from .refinement import refine
from .worlds import build_world


def teach(
    env_id: str,
    curriculum: Curriculum,
    *,
    seed: int,
    output: str | Path,
    env_kwargs: Mapping[str, Any] | None = None,
    config_path: str | Path | None = None,
    progress: bool = True,
    resume: bool = False,
    **overrides: Any,
) -> Path:
    """Train and return the path of the policy.

    Args:
        env_id: an environment of kfenv whose episodes carry the truth.
        seed: the same seed gives the same policy, on the same machine and libraries; but with
            a budget in minutes only if it comes to the same number of updates.
        output: a new or empty folder, or with `resume` that of an earlier run.
        env_kwargs: of the environment; it is observed in full unless told otherwise.
        config_path, overrides: settings that differ from the bundled ones.

    Raises:
        TrainingInterrupted: Ctrl-C or SIGTERM; the checkpoint is saved.
        FileExistsError: if `output` holds files already and `resume` is not set.
        ValueError: for an argument or a setting that is wrong.
    """
    settings = read_settings("taught", config_path, None, **overrides)
    teacher = None if curriculum.teacher is None else _teacher(curriculum.teacher)
    kwargs = {"observation": "full"} | dict(env_kwargs or {})
    if teacher is not None and teacher.single_channels:
        kwargs = {"actions": list(teacher.own_options["actions"])} | kwargs
    if curriculum.init is not None:
        kwargs = Learned(curriculum.init).given_options | kwargs
    parts = build_world(env_id, kwargs, curriculum.world)
    if teacher is not None:
        teacher = teacher.suited_to(parts[0].scenario)
    config = describe_run(env_id, kwargs, "taught", settings, seed)
    config["curriculum"] = asdict(curriculum)
    folder = Path(output)
    admit(folder, config, resume)
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder), torch_threads(settings.torch_threads), stop_as_event() as stop:
        write_json(folder / "config.json", config)
        course = Course(folder, config, settings, curriculum, kwargs, parts, seed)
        _run(course, teacher, stop, progress)
    return folder / "policy.npz"


def _run(course: Course, teacher: Agent | None, stop: Event, shown: bool) -> None:
    """Lessons, then refinement, from where the run has come to."""
    try:
        if teacher is not None and course.curriculum.init is None:
            hold_lessons(course, teacher, stop, shown)
        if not stop.is_set():
            refine(course, stop, shown)
        course.save(finished=not stop.is_set())
    finally:
        course.close()
    if stop.is_set():
        raise TrainingInterrupted(
            f"stopped after {course.done.rounds} rounds of lessons and {course.done.updates} "
            f"updates through the filter; the checkpoint is in {course.folder}: give the same "
            "command with --resume (resume=True) to go on"
        )


def _teacher(name: str) -> Agent:
    teacher = make_agent(name)
    if isinstance(teacher, RecordingFilter) or not isinstance(teacher, Agent):
        raise ValueError(f"{name} turns no knobs, so it cannot teach: name an agent or a policy.")
    return teacher
