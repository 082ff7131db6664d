"""The environments' pages: what they share, filled from the scenario, amid what is their own.

An environment's docstring says what is special about it and names the shared paragraphs,
as ``{rewards}``, where they belong; `with_page` writes them out, so that ``help`` shows the
whole page. ``{scenario.rate:g}`` is an attribute of the scenario with default arguments,
``{module.DURATION:g}`` a constant of the module that defines it, ``{flight.MAX_RANGE:g}`` one
of the random flights, ``{preset[random]}`` the faults of a preset. A literal brace is doubled.
"""

from __future__ import annotations

import sys
from inspect import cleandoc
from textwrap import indent
from typing import Any

import numpy as np

from kfenv.envs.channels import told_channels
from kfenv.envs.fault_lists import known_faults, named_faults
from kfenv.envs.knobs import (
    CHANNEL_NOISE,
    FADING,
    MEASUREMENT_NOISE,
    OUTLIER_WEIGHT,
    PROCESS_NOISE,
    WIDEST_FADING,
    Knob,
    knobs_of,
)
from kfenv.envs.observation_page import observation_space
from kfenv.envs.options import ENGINE, FULL, GAUSSIAN_SUMS, REWARDS, SHORT, Options
from kfenv.envs.plots_page import plots
from kfenv.envs.rewards import CAP, worst
from kfenv.envs.statistics import WINDOWS
from kfenv.envs.wording import factor, listed, paragraphs, table, wrap
from kfenv.filters.adaptive import told_design
from kfenv.models.model import Component
from kfenv.scenarios import trajectories
from kfenv.scenarios.scenario import MAX_RATE, MIN_RATE


def with_page(env_class: type) -> type:
    """Write out the docstring of an environment: a decorator.

    Raises:
        KeyError: for a paragraph that there is not.
        AttributeError: for an attribute that the scenario has not.
    """
    if env_class.__doc__:  # not where Python strips docstrings
        env_class.__doc__ = compose(env_class.__doc__, env_class.scenario_class)
    return env_class


def compose(text: str, scenario_class: type) -> str:
    """The text with its shared paragraphs and figures filled in, wrapped anew."""
    scenario = scenario_class()
    figures = {
        "scenario": scenario,
        "module": sys.modules[scenario_class.__module__],
        "flight": trajectories,
        "preset": {
            name: named_faults(faults, scenario.known_faults)
            for name, faults in scenario.presets.items()
        },
    }
    shared = {paragraph.__name__: paragraph(scenario) for paragraph in PARAGRAPHS}
    lines = []
    for line in cleandoc(text).splitlines():
        newline = "\n" + line[: len(line) - len(line.lstrip())]  # keeps a paragraph's indent
        lines.append(
            line.format(**figures, **{k: v.replace("\n", newline) for k, v in shared.items()})
        )
    return wrap("\n".join(lines))


def _if_rare(scenario: Any, text: str) -> str:
    """The text, where measurements are rarer than filter steps."""
    return text if scenario.steps_per_measurement > 1 else ""


# ----- Description ----------------------------------------------------------------------


def decisions(scenario: Any) -> str:
    """How an episode and a decision go; ends with the filter."""
    return paragraphs("""
        Every random thing (truth, faults, noise) is drawn before the filter runs, so that the
        action changes the filter and never the world. Before each decision the agent sees the
        innovation of the *pending* measurement, formed with nominal knobs; the step then
        applies the knobs to that measurement, updates, and predicts to the next one. The filter
        is a square-root sigma-point filter with the exact Joseph form""")


def info(scenario: Any) -> str:
    """What `info` holds."""
    states = ", ".join(f"{state.name} ({state.unit})" for state in scenario.motion.states)
    yardstick = scenario.yardstick
    error = f"``{yardstick.error_name}`` ({yardstick.unit})"
    return paragraphs(
        "``info`` holds, after ``reset`` and every ``step``:",
        f"""
        - ``time`` (s) of the filter step made last, its {error} and ``nis`` (0 if
          nothing arrived), and its ``estimate`` of {len(scenario.motion.states)} states: {states};
        - of the measurement that is pending ``innovation``, in {told_channels(scenario.sensor)},
          ``innovation_variance`` in the squares of these units, and ``noise``, the standard
          deviations that the filter is told; innovation and variance are zero and infinite in
          channels that are missing and at the episode's end;
        - where the truth is known ``truth`` and ``nees`` (of {_what(scenario)},
          {len(yardstick)} degrees of freedom);
        - with knobs of single channels ``innovation_covariance``, zero for missing channels;
        - after a step ``knobs``, the factors applied.""",
    )


# ----- Spaces ---------------------------------------------------------------------------


def action_space(scenario: Any) -> str:
    """The knobs."""
    knobs = knobs_of(scenario.sensor.groups, state_groups=scenario.motion.groups)
    return paragraphs(
        f"""
        ``Box(-1, 1, ({len(knobs)},), float32)``, one component a per knob, less where ``actions``
        exposes less. The factor is high^a for a >= 0 and low^-a for a < 0, so that zero is
        the nominal filter. Values beyond the space are taken to its edge.
        {_if_rare(scenario, "Fading acts at the instants of measurements alone.")}""",
        table(("Knob", "Range", "Meaning"), map(_knob_row, knobs)),
        f"""
        A Gaussian sum as ``filter`` has one knob more, ``{OUTLIER_WEIGHT.name}``
        ({_range(OUTLIER_WEIGHT)}), which multiplies the odds that it gives an outlier.""",
        f"""
        ``actions`` may also name channels ({told_channels(scenario.sensor)}), or
        ``"{CHANNEL_NOISE}"`` for all {len(scenario.sensor.channels)}. Such a knob multiplies the
        channel's standard deviation on top of its group's, has the same range, and stands behind
        those above.""",
    )


def _knob_row(knob: Knob) -> tuple[str, str, str]:
    meaning = {
        FADING: "multiplies the propagated covariance, before its noise",
        PROCESS_NOISE.name: "multiplies the covariance of the process noise",
        f"bias_{PROCESS_NOISE.name}": "multiplies that of the biases besides",
    }.get(knob.name, f"multiplies the standard deviation of the {knob.name.replace('_', ' ')}")
    return knob.name, _range(knob), meaning


def _range(knob: Knob) -> str:
    return f"{factor(knob.low)} to {factor(knob.high)}"


# ----- Rewards and episodes ---------------------------------------------------------------


def rewards(scenario: Any) -> str:
    """What a decision earns."""
    scale, lost_distance = scenario.error_scale, scenario.lost_distance
    unit = scenario.yardstick.unit
    most = [f"{round(worst(name, scale, lost_distance), 1):g}" for name in REWARDS]
    return paragraphs(
        f"""
        The error scale is {scale:g} {unit}. Errors are those of {_what(scenario)}, {unit}.""",
        f"""
        - ``"rmse"`` (default): the undiscounted return of an episode is minus its RMSE over the
          error scale, exactly as contests count it. A decision earns minus what it adds to
          sqrt(M / N) / scale - K / N: N is the number of instants in the episode that are
          scored, K that of those still to come, and M the sum of squared errors, one scale
          supposed where there is none yet.
        - ``"log-rmse"``: the same with log(sqrt(M / N) / scale). The return is exactly minus the
          log of the RMSE over the scale.
        - ``"improvement"``: log of the RMS error of a nominal filter on the same measurements
          over this filter's, within a decision, between {-CAP:g} and
          {CAP:g}; of less variance, for training. Its sum weighs all decisions alike,
          and so ranks agents otherwise than the RMSE.
        - ``"likelihood"``, without truth: log-likelihood of the *next* innovation, formed with
          the action still held, over the nominal filter's, per channel that arrives, between
          {-CAP:g} and {CAP:g}. Leave the process noise among the ``actions``: with knobs of
          measurement noise alone a manoeuvre is read as noise.
        - ``"consistency"``, without truth: minus the mean over the channel groups of the size of
          log RMS and of lag-1 correlation of the whitened next innovations, over some
          {WINDOWS[-1]:g} arrivals, at least {-CAP:g}: zero where the NIS is at its chi-square mean
          and the innovations are white. It tells noise that is misjudged, not how large errors
          are.""",
        f"""
        A lost track pays at once for all that remained: {_far(scenario)} at every scored
        instant, at most {most[0]} or, as a log, {most[1]} in all; with the other
        three {most[2]} for every decision. So losing it never pays. Without truth, and with the
        track kept, the first three are zero.""",
    )


def _what(scenario: Any) -> str:
    """What errors are those of."""
    name = scenario.yardstick.name
    return f"the {name}" if name == "position" else f"what is {name}"


def _far(scenario: Any) -> str:
    """The error of a lost track."""
    far, unit = scenario.lost_distance, scenario.yardstick.unit
    return f"{far / 1e3:g} km" if unit == "m" and far >= 1e3 else f"{far:g} {unit}"


def random_flight(scenario: Any) -> str:
    """What flies unless told otherwise."""
    return paragraphs(f"""
        The flight is random: {_flown("manoeuvring")},
        {trajectories.MIN_ALTITUDE:g} to {trajectories.MAX_ALTITUDE:g} m high""")


def smooth_flight(scenario: Any) -> str:
    """What flies smoothly."""
    return f"long {_flown('smooth')}"


def _flown(flights: str) -> str:
    style = trajectories.STYLES[flights]
    slowest, fastest = np.degrees(style.turn_rate)
    return f"""straight legs, turns of {slowest:g} to {fastest:g} deg/s, climbs and changes of
        speed, {style.speed[0]:g} to {style.speed[1]:g} m/s"""


def initial_deviations(scenario: Any) -> str:
    """How well the filter knows where it starts."""
    names: dict[str, list[str]] = {}
    for state, deviation in zip(scenario.motion.states, scenario.initial_deviations, strict=True):
        names.setdefault(_with_unit(deviation, state), []).append(state.name)
    axes = [told for told, states in names.items() if len(states) > 1]
    single = [f"{told} of the {states[0]}" for told, states in names.items() if len(states) == 1]
    more = f", {listed(single)}" if single else ""
    return f"""The initial estimate is drawn about the truth with standard deviations
        {listed(axes)} per axis{more}, which the filter knows"""


def _with_unit(value: float, state: Component) -> str:
    return f"{np.degrees(value):.3g} deg" if state.angle else f"{value:.3g} {state.unit}"


def first_decision(scenario: Any) -> str:
    """What happens at the first instant."""
    return paragraphs("""
        The first decision concerns the measurement at the first instant, which updates the
        initial state without a prediction.""")


def episode_end(scenario: Any) -> str:
    """When it is over."""
    return paragraphs(f"""
        Terminated when the track is lost: a {scenario.yardstick.name} error above
        {_far(scenario)}, or a filter that fails (numbers that are not finite).
        Truncated after the last instant, which is after ``duration * rate + 1`` filter
        steps
        ({len(scenario.time)} by default).""")


# ----- Arguments --------------------------------------------------------------------------


def rates(scenario: Any) -> str:
    """Between what `rate` may lie."""
    return f"{MIN_RATE:g} to {MAX_RATE:g} (default {scenario.rate:g})"


def track_file(scenario: Any) -> str:
    """What `track` is."""
    return paragraphs("""
        path of a CSV file with the columns t (s), lat, lon (degrees) and alt_m (m) or alt_ft
        (feet) of a real flight, which becomes the truth, smoothed""")


def radar_position(scenario: Any) -> str:
    """Where the radar stands beside a real flight."""
    return paragraphs("""
        latitude and longitude (degrees) and height (m) of the radar beside that flight; without
        it the window is placed at random.""")


def other_faults(scenario: Any) -> str:
    """Faults that are no preset."""
    modules = dict.fromkeys(fault.__module__ for fault in scenario.known_faults.values())
    mapping = """
        - a mapping from names to parameters, e.g. ``{"jamming": {"start": 20, "bursts":
          [1, 1]}}``. The names, and the parameters with their defaults, which hold above too
          where nothing else is said:"""
    objects = f"""
        - a list of such objects from {listed(f"`{module}`" for module in modules)}, or of one's
          own: anything with a ``label`` and a method ``apply(draft, rng)``."""
    items = indent(known_faults(scenario.known_faults), "  ")
    return "\n\n".join((cleandoc(mapping), items, cleandoc(objects)))


def options(scenario: Any) -> str:
    """The arguments that every environment has."""
    one = _if_rare(scenario, ", those from one measurement to the next")
    return paragraphs(
        f"""
        - ``reward``: {listed(f'``"{name}"``' for name in REWARDS)}, see Rewards.
        - ``observation``: ``"{SHORT}"`` (default) or ``"{FULL}"``, with a memory, see
          Observation Space.
        - ``actions``: names of the knobs to expose, from the table above;
          ``"{MEASUREMENT_NOISE}"`` stands for the {len(scenario.sensor.groups)} noise knobs there,
          ``"{CHANNEL_NOISE}"`` for one on each channel. Default all of the table.
        - ``most_fading``: upper end of the fading knob, above 1 (default {Options.most_fading:g},
          which a learner can explore; published rules ask for more and get {WIDEST_FADING:g}).
        - ``recording``: {_recording(scenario)}
        - ``decision_interval``: filter steps for which an action holds, 1 or more (default
          {scenario.steps_per_measurement}{one}).
        - ``filter``: {_filters(scenario)}
        - ``kappa``: spread of the sigma points, 0 or more (default {Options.kappa:g}).
        - ``render_mode``: ``"rgb_array"``, ``"human"`` or None (default).""",
        """
        The vector environment also takes ``num_envs`` and ``autoreset_mode``
        (``"next_step"``, ``"same_step"`` or ``"disabled"``), ``info="none"`` to tell nothing and be
        faster, ``threads`` to step on several cores, and does not render.""",
    )


def _recording(scenario: Any) -> str:
    drawn = "faults and track" if hasattr(scenario, "track") else "faults"
    apart = """ How far its measurements lie apart is not looked at: give ``rate`` and
        ``measurement_rate`` as it has them, by which fading and the default
        ``decision_interval`` go."""
    return f"""a `kfenv.scenarios.recording.Recording` to replay instead of drawing episodes, one
        after the other; a seeded ``reset`` starts again at the first. Its times take the place of
        ``duration`` and ``rate``, and {drawn} are not used.{_if_rare(scenario, apart)}"""


def _filters(scenario: Any) -> str:
    mixture = told_design(GAUSSIAN_SUMS[0], scenario.mixture).mixture
    return f"""``"{ENGINE}"`` (default, compiled), or a square-root design of
        `kfenv.filters.designs`, e.g. ``"srukf-joseph"`` with the Jacobian at the posterior as
        published or ``"srukf-joseph-prior"`` at the prediction; those are slow. The Gaussian sums
        {listed(f'``"{name}"``' for name in GAUSSIAN_SUMS)} hold {100.0 * mixture.weight:g} % of the
        measurements for outliers of {mixture.ratio:g} times the variance, and have a knob
        ``{OUTLIER_WEIGHT.name}`` on the odds of that, but no ``kappa``."""


def vector_arguments(scenario: Any) -> str:
    """What a vector environment takes and promises."""
    channels, states = len(scenario.sensor.channels), len(scenario.motion.states)
    numbers = states + 2 * channels + sum(scenario.dimensions) + 2  # truth's weight, nominal error
    megabytes = 8e-6 * numbers * len(scenario.time)
    return paragraphs(f"""
        Takes ``num_envs`` and ``autoreset_mode`` (``"next_step"`` by default, ``"same_step"``
        for libraries that expect a fresh observation at once, ``"disabled"``), ``info``
        (``"full"``, or ``"none"`` for empty ones, which learners seldom read and which take time),
        ``max_episode_steps`` (as `gymnasium.make` does), ``threads`` (1 by default; as many as
        there are cores pay from some hundred sub-environments on), and every argument of the
        single environment but ``render_mode``. Sub-environment i seeded with s + i gives
        the same bits as a single environment seeded so, in however many threads; of a
        ``recording`` it replays the episodes i, i + num_envs, and so on. A sub-environment holds
        its episode, {megabytes:.2g} MB by default.""")


PARAGRAPHS = (
    decisions, info, action_space, observation_space, rewards, random_flight, smooth_flight,
    initial_deviations, first_decision, episode_end, rates, track_file, radar_position, plots,
    other_faults, options, vector_arguments,
)  # fmt: skip
