"""Figures of a contest."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from kfenv.scenarios.recording import Recording

from ..contestants.registry import make_agent
from ..plotting import COLOURS, clean, save, shade
from .evaluation import Contest
from .rollout import draw_episodes, rollout, scenario_and_options
from .scores import Scores, read_scores, read_values

Array = NDArray[np.float64]


def draw_contest(contest: Contest, results: Sequence[dict[str, Any]], output: Path) -> list[Path]:
    """Write the figures of an evaluated contest and return their paths."""
    paths = [output / "rmse.png", output / "improvement.png", output / "episode.png"]
    save(_distributions(results, output), paths[0])
    save(_improvements(results), paths[1])
    save(_episode(contest, results, output), paths[2])
    window = _widest_window(contest)
    if window is not None:
        paths.append(output / "map.png")
        save(_map(contest, results, output, window), paths[3])
    return paths


def _ranked(results: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    return sorted(results, key=lambda result: result["rmse_median"])


def _colour(result: dict[str, Any], results: Sequence[dict[str, Any]]) -> str:
    """An agent keeps its colour in all figures of a contest."""
    return COLOURS[[r["agent"] for r in results].index(result["agent"]) % len(COLOURS)]


def _distributions(results: Sequence[dict[str, Any]], output: Path) -> Figure:
    """Cumulative distribution of the episodes' RMSE."""
    figure = Figure((10.0, 4.8), layout="constrained")
    axes = figure.subplots()
    for result in _ranked(results):
        rmse = np.sort(read_scores(output, result["given_as"]).rmse)
        share = np.arange(1, len(rmse) + 1) / len(rmse)
        median = result["rmse_median"]
        told = f"{median:.{0 if median >= 10.0 else 1}f}" if median >= 1.0 else f"{median:.2g}"
        label = f"{result['agent']}  ({told} {result.get('unit', 'm')})"
        axes.step(rmse, share, where="post", color=_colour(result, results), label=label, lw=1.6)
    axes.set_xscale("log")
    what, unit = results[0].get("scored", "position"), results[0].get("unit", "m")
    axes.set_xlabel(f"{what} RMSE of an episode, {unit}")
    axes.set_ylabel("share of episodes")
    axes.set_ylim(0.0, 1.0)
    axes.set_title(f"{results[0]['env']}: {results[0]['episodes']} unseen episodes", loc="left")
    axes.legend(frameon=False, title="agent (median)", loc="center left",
                bbox_to_anchor=(1.0, 0.5), fontsize=9)  # fmt: skip
    clean(axes)
    return figure


def _improvements(results: Sequence[dict[str, Any]]) -> Figure:
    """Median improvement over the nominal filter on the same episode, with its interval."""
    ranked = [r for r in _ranked(results)[::-1] if r["agent"] != "fixed"]
    figure = Figure((8.0, 0.42 * len(ranked) + 1.6), layout="constrained")
    axes = figure.subplots()
    for row, result in enumerate(ranked):
        low, middle, high = (
            np.nan if result[key] is None else 100.0 * max(result[key], -1.0)
            for key in ("ci_low", "improvement_over_fixed", "ci_high")
        )
        axes.plot([low, high], [row, row], color=COLOURS[4], lw=4, solid_capstyle="butt", alpha=0.4)
        axes.plot(middle, row, "o", color=COLOURS[4])
    axes.axvline(0.0, color="black", lw=0.8)
    axes.set_yticks(range(len(ranked)), [result["agent"] for result in ranked])
    keys = ("ci_low", "improvement_over_fixed")
    far_below = any((result[key] or 0.0) < -0.25 for result in ranked for key in keys)
    axes.set_xlim(-105.0 if far_below else -30.0, 100.0)
    axes.set_xlabel("RMSE below the nominal filter's on the same episode, %: median, 95 % interval")
    if far_below:
        axes.set_title("-100 % stands for that or worse", loc="left", fontsize=9)
    clean(axes)
    return figure


def _episode(contest: Contest, results: Sequence[dict[str, Any]], output: Path) -> Figure:
    """Error and one knob over an episode on which the nominal filter does as usual."""
    fixed = read_scores(output, "fixed").rmse
    chosen = int(np.argsort(fixed)[len(fixed) // 2])
    recording = draw_episodes(
        contest.env_id, contest.env_kwargs, contest.split, contest.seed, contest.episodes
    )[[chosen]]
    figure = Figure((9.0, 6.0), layout="constrained")
    top, bottom = figure.subplots(2, sharex=True, height_ratios=(3, 2))
    scenario, _ = scenario_and_options(contest.env_id, contest.env_kwargs)
    yardstick = scenario.yardstick
    groups, channels = len(scenario.sensor.groups), len(scenario.sensor.channels)
    noise = slice(2, 2 + groups), slice(-channels, None)
    for result in _shown(results):
        scores = _traced(contest, result, output, recording)
        time = scores.time
        style = {"color": _colour(result, results), "lw": 1.3, "label": result["agent"]}
        top.plot(time, scores.error[:, 0], **style)
        means = [np.log(scores.factors[:, 0, part]).mean(axis=1) for part in noise]
        bottom.plot(time, np.exp(sum(means)), **style)
    shade(top, recording.faults[0])
    shade(bottom, recording.faults[0], labelled=False)
    for axes, label in (
        (top, f"{yardstick.name} error, {yardstick.unit}"),
        (bottom, "noise factor\n(mean of all)"),
    ):
        axes.set_yscale("log")
        axes.set_ylabel(label)
        clean(axes)
    top.set_ylim(scenario.error_scale / 200.0, 2.0 * scenario.lost_distance)
    top.set_title(f"Episode {chosen}, on which the nominal filter does as usual", loc="left")
    top.legend(frameon=False, ncols=3, fontsize=9)
    bottom.set_xlabel("time, s")
    return figure


def _traced(contest: Contest, result: dict[str, Any], output: Path, recording: Recording) -> Scores:
    """A recording once more for an agent, with the parameters that it was scored with."""
    agent = make_agent(result["given_as"])
    agent = agent.with_values(read_values(output, result["given_as"]))
    return rollout(agent, *contest.expected_place, recording, contest.seed, trace=True)


def _widest_window(contest: Contest) -> Recording | None:
    """Of a real log the window that leads farthest, None where episodes are no mapped log's."""
    scenario, _ = scenario_and_options(contest.env_id, contest.env_kwargs)
    if scenario.yardstick.name != "position":
        return None
    windows = scenario.recorded(contest.split, contest.episodes)
    if windows is None:
        return None
    extent = np.ptp(scenario.yardstick.values(windows.truth), axis=1)
    return windows[[int(np.argmax(np.linalg.norm(extent, axis=1)))]]


def _map(
    contest: Contest, results: Sequence[dict[str, Any]], output: Path, window: Recording
) -> Figure:
    """Estimated tracks over a real log's window, east and north of where it begins."""
    scenario, _ = scenario_and_options(contest.env_id, contest.env_kwargs)
    values = scenario.yardstick.values
    origin, rotation = scenario.local_frame(values(window.mean[0]))
    truth = values(window.truth[0])
    figure = Figure((8.0, 6.4), layout="constrained")
    axes = figure.subplots()
    for result in _shown(results):
        scores = _traced(contest, result, output, window)
        track = truth[np.searchsorted(window.times[0], scores.time)] + scores.off[:, 0]
        axes.plot(*_east_north(track, origin, rotation), color=_colour(result, results), lw=1.3,
                  label=result["agent"])  # fmt: skip
    known = slice(None) if window.scored is None else window.scored[0] > 0.0
    axes.plot(*_east_north(truth[known], origin, rotation), ".", color=COLOURS[7], ms=5, zorder=1,
              label="truth" if window.scored is None else "withheld fixes")  # fmt: skip
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    axes.set_title(f"{contest.env_id}: the window that leads farthest", loc="left")
    axes.legend(frameon=False, fontsize=9)
    clean(axes)
    return figure


def _east_north(position: Array, origin: Array, rotation: Array) -> tuple[Array, Array]:
    """Positions (T, 3) of the state's frame on the map."""
    east, north, _ = rotation @ (position - origin).T
    return east, north


def _shown(results: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The fixed ones, the clairvoyant and the three best of the others."""
    always = ("fixed", "fixed-tuned", "clairvoyant")
    others = [r for r in _ranked(results) if r["agent"] not in always][:3]
    return [r for r in results if r["agent"] in always] + others


def draw_error_against_cost(tested: Sequence[dict[str, Any]], path: Path) -> None:
    """Write a figure of error against cost; hollow is who is shown what nobody knows.

    Who is worse than twice `fixed` is left out, and named under the figure.
    """
    figure = Figure((8.0, 5.4), layout="constrained")
    axes = figure.subplots()
    known = [result for result in tested if result["cost"] is not None]
    most = 2.0 * max(
        (r["rmse_geometric_mean"] for r in known if r["agent"] == "fixed"), default=1e9
    )
    places = {
        result["agent"]: (result["cost"], result["rmse_geometric_mean"])
        for result in known
        if result["rmse_geometric_mean"] <= most
    }
    for agent, place in places.items():
        face = "white" if "clairvoyant" in agent else COLOURS[4]
        axes.plot(*place, "o", color=COLOURS[4], markerfacecolor=face)
    axes.set_xscale("log")
    axes.set_yscale("log")
    out = [result["agent"] for result in known if result["agent"] not in places]
    beside = f"\nbeyond the figure: {', '.join(out)}" if out else ""
    axes.set_xlabel(
        f"CPU time of filter and agent, the bare engine's predict and update = 1{beside}"
    )
    axes.set_ylabel("geometric mean of the position RMSE, m")
    episodes = tested[0]["episodes"]
    axes.set_title(f"{tested[0]['suite']}: {episodes} unseen episodes", loc="left")
    clean(axes)
    _name(axes, places)
    save(figure, path)


def _name(axes: Any, places: dict[str, tuple[float, float]]) -> None:
    """Write names beside their points, each shifted upwards until it covers no other."""
    axes.figure.draw_without_rendering()
    scale, taken = axes.figure.dpi / 72.0, []
    for name, place in sorted(places.items(), key=lambda item: item[1][1]):
        x, y = axes.transData.transform(place) / scale
        width, up = 4.7 * len(name) + 8.0, 2.0
        while any(abs(y + up - b) < 9.0 and x < right and x + width > left
                  for left, right, b in taken):  # fmt: skip
            up += 1.0
        taken.append((x, x + width, y + up))
        line = {"arrowstyle": "-", "lw": 0.4, "color": "#999999"} if up > 8.0 else None
        axes.annotate(
            name, place, (6, up - 2.0), textcoords="offset points", fontsize=8, arrowprops=line
        )
