"""What the contestants share that run the environments' compiled filter in a way of their own."""

from __future__ import annotations

from typing import Any

from kfenv.envs.options import ENGINE, Options
from kfenv.models.own import is_compilable
from kfenv.scenarios.recording import Recording

from .agent import RecordingFilter


class CompiledFilter(RecordingFilter):
    """Base of those for whom no other filter than the compiled one can stand in."""

    def check(self, scenario: Any, options: Options, recording: Recording) -> None:
        """See `Contestant.check`.

        Raises:
            ValueError: if the environment works with another filter than the compiled one, or
                with a model that it cannot run.
        """
        if not (is_compilable(scenario.motion) and is_compilable(scenario.sensor)):
            raise ValueError(
                f"{self.name} works with the compiled filter, which cannot run a model of NumPy "
                "functions: write f(xp) and h(xp) with the namespace, or leave it out."
            )
        if options.filter != ENGINE:
            raise ValueError(
                f"{self.name} works with the compiled filter {ENGINE!r}, and this environment "
                f"with filter={options.filter!r}: leave out one of them."
            )
