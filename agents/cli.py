"""The command line: `kfenv --help`."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from kfenv.filters.adaptive import ADAPTIVE_DESIGNS
from kfenv.filters.designs import DESIGNS

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Learn to tune an adaptive Kalman filter, and contest the classical ways of doing so.",
)
# The table of results needs 132 columns; a narrower terminal wraps it, but loses nothing.
console = Console(width=max(Console().width, 132), soft_wrap=True)

DEFAULT_AGENTS = (
    "innovation-fading", "innovation-fading-printed", "huber-gate", "innovation-noise",
    "clairvoyant", "random",
)  # fmt: skip
VALIDATION_EPISODES = 100  # at most, on which training's result is scored

Environment = Annotated[str, typer.Argument(metavar="ENV", help="An id that `kfenv envs` lists.")]
Seed = Annotated[int, typer.Option(min=0, help="The same seed gives the same result.")]
Rate = Annotated[
    float | None,
    typer.Option(help="Measurements per second; of InsGnss the inertial samples, not the fixes."),
]
Faults = Annotated[
    str | None,
    typer.Option(
        help="'random', 'paper', 'none', a JSON object, or another name that ENV's page tells."
    ),
]
Track = Annotated[
    Path | None, typer.Option(help="A real flight as the truth: CSV with t, lat, lon, alt_m.")
]
Rinex = Annotated[
    tuple[Path, Path] | None,
    typer.Option(
        metavar="OBS NAV",
        help="A real GPS log of a receiver that stood still: RINEX 2 or 3 observation and "
        "navigation file. It is cut into windows: the first 30 % of its time for training and "
        "tuning, 20 % for validation, the last half for the test, without overlap.",
    ),
]
Option = Annotated[
    list[str] | None,
    typer.Option("--option", help="KEY=VALUE, any other keyword of ENV, value in JSON."),
]
Resume = Annotated[bool, typer.Option(help="Go on with what is in the output folder.")]


@app.command()
def envs() -> None:
    """List the environments."""
    import gymnasium

    import kfenv

    table = Table("id", "what", "observes", "knobs", "rate", "episode", box=SIMPLE_HEAD)
    for env_id in kfenv.ENVIRONMENTS:
        env = gymnasium.make(env_id).unwrapped
        table.add_row(
            env_id,
            type(env).__doc__.splitlines()[0],
            str(env.observation_space.shape[0]),
            str(env.action_space.shape[0]),
            f"{env.scenario.rate:g} Hz",
            f"{env.scenario.duration:g} s",
        )
    console.print(table)
    console.print("Their pages: python -c \"import gymnasium, kfenv; "
                  "help(type(gymnasium.make('kfenv/RadarTracking-v0').unwrapped))\"")  # fmt: skip


@app.command()
def train(
    env: Environment,
    output: Annotated[Path, typer.Option(help="New folder for checkpoint, policy and logs.")],
    algo: Annotated[str, typer.Option(help="'ppo' or 'sac'.")] = "ppo",
    steps: Annotated[int, typer.Option(min=1, help="Environment steps in all.")] = 5_000_000,
    seed: Seed = 0,
    config: Annotated[
        Path | None, typer.Option(help="TOML file with settings that differ from the defaults.")
    ] = None,
    rate: Rate = None,
    faults: Faults = None,
    track: Track = None,
    rinex: Rinex = None,
    option: Option = None,
    resume: Resume = False,
) -> None:
    """Train an agent (needs the extra 'train')."""
    with _complaints():
        kwargs = _env_kwargs(rate, faults, track, rinex, option)
        train_agent = _training()
        if _real_log(kwargs):  # what would only show at the end
            _check_validation(env, kwargs, seed)
        train_agent(
            env, algorithm=algo, steps=steps, seed=seed, output=output, env_kwargs=kwargs,
            config_path=config, resume=resume,
        )  # fmt: skip
        _validate(env, kwargs, seed, output)
    console.print(f"The policy is in {output / 'policy.npz'}; contest it with")
    options = "".join(f" --option '{key}={json.dumps(kwargs[key])}'" for key in kwargs)
    console.print(f"  kfenv evaluate {env}{options} --agent {output} --output {output}-evaluation")


@app.command(epilog=f"Fixed filters of the family: {', '.join((*DESIGNS, *ADAPTIVE_DESIGNS))}.")
def evaluate(
    env: Environment,
    output: Annotated[Path, typer.Option(help="New folder for results and figures.")],
    agent: Annotated[
        list[str] | None,
        typer.Option(
            help="An agent, a fixed filter, or the path of a trained policy (NAME=PATH names it); "
            "repeat."
        ),
    ] = None,
    episodes: Annotated[int, typer.Option(min=2, help="Unseen episodes.")] = 200,
    seed: Seed = 0,
    rate: Rate = None,
    faults: Faults = None,
    track: Track = None,
    rinex: Rinex = None,
    option: Option = None,
    tuning_episodes: Annotated[
        int,
        typer.Option(min=1, help="Episodes that parameters are tuned on, none tested."),
    ] = 32,
    tuning_trials: Annotated[
        int, typer.Option(min=0, help="Settings tried per parameter; 0: no tuning.")
    ] = 60,
    processes: Annotated[int, typer.Option(min=1, help="Worker processes.")] = 2,
    resume: Resume = False,
) -> None:
    """Contest agents on the same unseen episodes: table, figures, results.json.

    Agents: fixed, fixed-tuned, innovation-fading, innovation-fading-printed, huber-gate,
    innovation-noise, clairvoyant, random. Without --agent all of them take part (but the
    clairvoyant in a real log, whose noise nobody knows).
    """
    with _complaints():
        kwargs = _env_kwargs(rate, faults, track, rinex, option)
        _contest(
            env, kwargs, tuple(agent or _default_agents(kwargs)), episodes, seed, tuning_episodes,
            tuning_trials, output, processes, resume,
        )  # fmt: skip


@app.command()
def reproduce(
    experiment: Annotated[
        str,
        typer.Argument(metavar="NAME", help="E1 to E6, hard (lost tracks), or all."),
    ],
    output: Annotated[Path, typer.Option(help="New folder for figures and claims.")],
    runs: Annotated[
        int | None, typer.Option(min=2, help="In place of each experiment's own number.")
    ] = None,
    seed: Seed = 0,
    processes: Annotated[int, typer.Option(min=1, help="Worker processes.")] = 2,
    resume: Resume = False,
) -> None:
    """Repeat the experiments of the papers: figures, and a table of which claims hold.

    E1 and E2: radar of constant noise at 10 and 2 Hz; E3: phased array under jamming and loss;
    E4: GNSS under a clock fault; E5: bistatic tracking; E6: inertial navigation with outlying
    fixes; hard: lost tracks in hard geometry.
    claims.md holds the table.
    """
    from .reproduction.claims import claims_table
    from .reproduction.experiments import chosen_experiments
    from .reproduction.experiments import reproduce as run_experiments

    with _complaints():
        names = chosen_experiments(experiment)
        with _progress() as bar:
            claims = run_experiments(names, output, runs, seed, processes, resume, bar)
        console.print(claims_table(claims))
        console.print(f"Figures and claims: {output}")


@app.command()
def bench() -> None:
    """Measure speed; with FilterPy installed, as a ratio to its filter."""
    from .bench import benchmark

    table = Table("what", "measured", "compared", "promised")
    with console.status("") as status:
        rows = benchmark(lambda what: status.update(f"Measuring {what} ..."))
    for row in rows:
        table.add_row(*row)
    console.print(table)


@app.command()
def demo(
    output: Annotated[Path, typer.Option(help="New folder for everything it writes.")] = Path(
        "demo"
    ),
    seed: Seed = 0,
    steps: Annotated[int, typer.Option(min=1, help="Training steps.")] = 5_000_000,
    episodes: Annotated[int, typer.Option(min=2, help="Unseen episodes.")] = 200,
    resume: Resume = False,
) -> None:
    """The whole idea in a few minutes: train an agent, then contest it.

    On kfenv/RadarTracking-v0 at 2 measurements per second, the harder contest.
    """
    env, kwargs = "kfenv/RadarTracking-v0", {"rate": 2.0}
    learned = output / "learned"
    with _complaints():
        if output.exists() and any(output.iterdir()) and not resume:
            raise FileExistsError(
                f"The folder {output} is not empty: name another with --output, or go on "
                "with --resume."
            )
        if not (resume and (learned / "policy.npz").exists() and _trained(learned) >= steps):
            console.print(f"Training PPO for {steps:,} steps on random flights and faults ...")
            _training()(
                env, algorithm="ppo", steps=steps, seed=seed, output=learned, env_kwargs=kwargs,
                resume=resume and learned.exists(),
            )  # fmt: skip
        console.print(f"Contest on {episodes} unseen episodes; every rule is tuned first ...")
        _contest(
            env, kwargs, (*DEFAULT_AGENTS, str(learned)), episodes, seed, 32, 60,
            output / "evaluation", 2, resume,
        )  # fmt: skip


def _check_validation(env: str, kwargs: dict[str, Any], seed: int) -> None:
    """Complain if a real log has too little for validation."""
    import kfenv  # noqa: F401  (registers the environments)

    from .evaluation import check_log

    check_log(env, _scored(kwargs), "validation", seed, VALIDATION_EPISODES)


def _scored(kwargs: dict[str, Any]) -> dict[str, Any]:
    """The keywords of training less the reward, which is no matter of scores."""
    return {key: value for key, value in kwargs.items() if key != "reward"}


def _validate(env: str, kwargs: dict[str, Any], seed: int, output: Path) -> None:
    """Score a trained policy on validation episodes: ``results.json`` beside it."""
    from .evaluation import Contest, evaluate
    from .files import write_json

    policies = (str(output),)
    contest = Contest(env, _scored(kwargs), policies, VALIDATION_EPISODES, seed, 1, 0, "validation")
    folder = output / "validation"
    shutil.rmtree(folder, ignore_errors=True)  # of an earlier, shorter run
    results = evaluate(contest, folder, processes=1)
    write_json(output / "results.json", results)
    console.print(_results_table(results, "validation episodes, nothing tuned"))


def _trained(folder: Path) -> int:
    try:
        return int(json.loads((folder / "training.json").read_text())["steps"])
    except (OSError, ValueError, KeyError):
        return 0


def _training() -> Callable[..., Path]:
    try:
        from .training import train
    except ImportError as error:
        raise ValueError(str(error)) from None
    return train


def _contest(
    env: str, kwargs: dict[str, Any], agents: tuple[str, ...], episodes: int, seed: int,
    tuning_episodes: int, tuning_trials: int, output: Path, processes: int, resume: bool,
) -> None:  # fmt: skip
    import kfenv  # noqa: F401  (registers the environments)

    from .evaluation import Contest, evaluate
    from .figures import draw_contest

    contest = Contest(env, kwargs, agents, episodes, seed, tuning_episodes, tuning_trials)
    with _progress() as bar:
        task = bar.add_task("agents", total=None)
        results = evaluate(
            contest, output, processes, resume,
            started=lambda total: bar.update(task, total=total),
            advance=lambda name: bar.update(task, advance=1, description=f"{name} done"),
        )  # fmt: skip
    console.print(_results_table(results))
    for path in draw_contest(contest, results, output):
        console.print(f"Figure: {path}")
    console.print(f"Results: {output / 'results.json'}")


def _default_agents(kwargs: dict[str, Any]) -> tuple[str, ...]:
    log = _real_log(kwargs)
    return tuple(name for name in DEFAULT_AGENTS if name != "clairvoyant" or not log)


def _real_log(kwargs: dict[str, Any]) -> bool:
    """Whether the episodes are windows of a real log."""
    return kwargs.get("rinex") is not None or kwargs.get("log") is not None


def _results_table(results: list[dict[str, Any]], where: str = "unseen episodes") -> Table:
    tuned = "difference_to_fixed_tuned" in results[0]
    notes = ["lost: tracks lost, %; ANEES: 1 if consistent, lost tracks left out"]
    if _real_log(results[0]["env_kwargs"]):
        had, asked = (results[0][key] for key in ("episodes", "episodes_asked"))
        count = f"{had}" if had == asked else f"{had} of {asked} asked"
        where = f"{count} windows of a real log, kept from training and tuning"
        notes.append("windows of one log resemble each other, so intervals are too narrow")
    table = Table(
        "agent", "median", "mean", "std", "p95", "lost", "ANEES", "below fixed, %",
        *(("vs fixed-tuned, m",) if tuned else ()),
        box=SIMPLE_HEAD,
        title=f"Position RMSE on {where}, m (medians with 95 % intervals)",
        caption="; ".join(notes),
    )  # fmt: skip
    for column in table.columns:
        column.no_wrap = True
    for column in table.columns[1:]:
        column.justify = "right"
    for r in sorted(results, key=lambda result: result["rmse_median"]):
        better = [100.0 * r[key] for key in ("improvement_over_fixed", "ci_low", "ci_high")]
        row = [
            r["agent"],
            *(_short(r[key]) for key in ("rmse_median", "rmse", "rmse_std", "rmse_p95")),
            f"{100.0 * r['track_loss']:.0f}",
            "-" if r["anees"] is None else "<0.01" if r["anees"] < 0.01 else _short(r["anees"]),
            f"{better[0]:+.0f} ({better[1]:+.0f}, {better[2]:+.0f})",
        ]
        if tuned:
            low, high = r["difference_ci_low"], r["difference_ci_high"]
            middle = r["difference_to_fixed_tuned"]
            row.append(f"{_signed(middle)} ({_signed(low)}, {_signed(high)})")
        table.add_row(*row)
    return table


def _short(number: float) -> str:
    return f"{number:.3g}" if abs(number) < 1000.0 or abs(number) >= 1e5 else f"{number:.0f}"


def _signed(metres: float) -> str:
    return f"{metres:+.0f}" if abs(metres) >= 9.95 else f"{metres:+.1f}"


@contextmanager
def _progress() -> Iterator[Progress]:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        yield bar


def _env_kwargs(
    rate: float | None, faults: str | None, track: Path | None, rinex: tuple[Path, Path] | None,
    option: list[str] | None,
) -> dict[str, Any]:  # fmt: skip
    """The environment's keywords; complains of an option that is no KEY=VALUE."""
    kwargs: dict[str, Any] = {}
    for item in option or ():
        key, equals, value = item.partition("=")
        if not equals:
            raise ValueError(f"--option {item!r} is not of the form KEY=VALUE.")
        kwargs[key] = _json_or_text(value)
    if rate is not None:
        kwargs["rate"] = rate
    if faults is not None:
        kwargs["faults"] = _json_or_text(faults)
    if track is not None:
        kwargs["track"] = str(track.resolve())
    if rinex is not None:
        kwargs["rinex"] = [str(path.resolve()) for path in rinex]
    return kwargs


def _json_or_text(value: str) -> Any:
    try:
        return json.loads(value)
    except json.JSONDecodeError:
        return value


@contextmanager
def _complaints() -> Iterator[None]:
    """One sentence instead of a traceback for what the user can mend."""
    from gymnasium.error import Error as GymnasiumError

    try:
        yield
    except KeyboardInterrupt as interrupt:
        message = str(interrupt) or "Interrupted: what was finished is kept; go on with --resume."
        Console(stderr=True).print(message, soft_wrap=True)
        raise typer.Exit(130) from None
    except (ValueError, TypeError, OSError, RuntimeError, GymnasiumError) as error:
        Console(stderr=True).print(f"[red]Error:[/red] {escape(str(error))}", soft_wrap=True)
        raise typer.Exit(2) from None


if __name__ == "__main__":
    app()
