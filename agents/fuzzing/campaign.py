"""A campaign: cases of all subjects in turn for a time; what was found, told once and kept."""

from __future__ import annotations

import re
import signal
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from zlib import crc32

from numpy.random import default_rng

from .subject import Case, Subject, save_case

LONGEST = 60  # s of the processor that a case may take, compiling included
MOST_MEMORY = 4 * 2**30  # bytes beyond what is taken at the start
LETTERS = 70  # of what is said, by which kinds of findings are told apart
VARYING = re.compile(r"'.*?'|\"[^\"]*\"|\S*/\S*|0x\w+|[-+]?\d[\d.e+-]*")
OURS = Path(__file__).parents[2]


class TookTooLong(BaseException):
    """A case that does not end; no `except Exception` may swallow it."""


@dataclass
class Tally:
    """What became of a subject's cases.

    Attributes:
        cases, steps: how many; steps are the filters'.
        seconds: spent.
        findings: for each kind what is wrong, how often, and the file of the first case.
    """

    cases: int = 0
    steps: int = 0
    seconds: float = 0.0
    findings: dict[str, tuple[int, Path]] = field(default_factory=dict)


def fuzz(
    subjects: Sequence[Subject],
    seed: int,
    output: Path,
    minutes: float | None = None,
    cases: int | None = None,
    advance: Callable[[dict[str, Tally]], None] = lambda tallies: None,
) -> dict[str, Tally]:
    """Try subjects until the time is over, all for the same time; Ctrl-C ends it before.

    Args:
        subjects: with different names.
        seed: of the cases: the same seed tries the same ones.
        output: folder for the cases that were findings.
        minutes: in all; None to go by `cases`.
        cases: of each subject.
        advance: called after each case.
    """
    tallies = {subject.name: Tally() for subject in subjects}
    began = time.monotonic()
    try:
        while minutes is None or time.monotonic() - began < 60.0 * minutes:
            left = [s for s in subjects if cases is None or tallies[s.name].cases < cases]
            if not left:
                break
            subject = min(left, key=lambda s: tallies[s.name].seconds)
            _one_case(subject, tallies[subject.name], seed, output)
            advance(tallies)
    except KeyboardInterrupt:
        pass  # what was found is told
    return tallies


def _one_case(subject: Subject, tally: Tally, seed: int, output: Path) -> None:
    began = time.monotonic()
    rng = default_rng([seed, crc32(subject.name.encode()), tally.cases])
    case = subject.draw(rng)
    steps, wrong = attempt(subject, case)
    tally.cases, tally.steps = tally.cases + 1, tally.steps + steps
    if wrong is not None:
        often, path = tally.findings.get(wrong, (0, output / _name(subject, seed, tally)))
        if not often:
            output.mkdir(parents=True, exist_ok=True)
            save_case(path, subject.name, case)
        tally.findings[wrong] = (often + 1, path)
    tally.seconds += time.monotonic() - began


def _name(subject: Subject, seed: int, tally: Tally) -> str:
    return f"{subject.name}-{seed}-{tally.cases}.npz"


def attempt(subject: Subject, case: Case) -> tuple[int, str | None]:
    """Try a case: its steps, and what is wrong, where, if anything is."""
    try:
        with _time_limit(), _memory_limit(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return subject.attempt(case), None
    except (Exception, TookTooLong) as error:
        return 0, _told(error)


def _told(error: BaseException) -> str:
    """One line that is the same for all findings of a kind: the error, and our innermost line."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if _is_ours(f.filename)]
    place = Path(frames[-1].filename).relative_to(OURS)
    said = VARYING.sub("*", str(error).partition("\n")[0])
    return f"{place}:{frames[-1].lineno}: {type(error).__name__}: {said[:LETTERS]}"


def _is_ours(filename: str) -> bool:
    return Path(filename).is_relative_to(OURS) and "site-packages" not in filename


@contextmanager
def _time_limit() -> Iterator[None]:
    """Raise in what takes too long, where signals can tell."""
    if not hasattr(signal, "setitimer"):
        yield
        return
    former = signal.signal(signal.SIGPROF, _stop)
    signal.setitimer(signal.ITIMER_PROF, LONGEST)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, former)


@contextmanager
def _memory_limit() -> Iterator[None]:
    """Let the system refuse what asks for too much memory, where it can."""
    try:
        import resource

        taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    except (ImportError, OSError):
        yield
        return
    former = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (taken + MOST_MEMORY, former[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, former)


def _stop(*_: object) -> None:
    raise TookTooLong(f"a case takes more than {LONGEST} s")
