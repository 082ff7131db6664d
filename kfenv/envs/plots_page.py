"""The argument of the environments' pages that takes a log of plots."""

from __future__ import annotations

from typing import Any

from kfenv.envs.wording import listed, paragraphs
from kfenv.scenarios.radar.plot_log import LEARNT, MAX_GAP, MAX_STEP, MISSED
from kfenv.scenarios.radar.plots import column
from kfenv.scenarios.windows import PARTS


def plots(scenario: Any) -> str:
    """Real plots in place of all that is simulated."""
    columns = [column(channel) for channel in scenario.sensor.channels]
    spreads = [column(channel, "_std") for channel in scenario.sensor.channels]
    turns = any(channel.angle for channel in scenario.sensor.channels)
    flight = " like ``track`` (``radar_position`` is then needed) or"
    axes = " in m east, north and up of the radar"
    low = f"{100 * PARTS['tuning'][1]:g} %"
    return paragraphs(f"""
        path of a CSV file with real plots of one target, or of it and of one with the true
        track, in place of all that is simulated. Its columns are ``t`` (s, hh:mm:ss or ISO 8601),
        {listed(f"``{name}``" for name in columns)}{turns * ", azimuths clockwise from north"}; an
        empty cell was not detected. Standard deviations that the filter is told stand in
        {listed(f"``{name}``" for name in spreads)}; without them they are measured on the first
        {low} of the log, by how far each plot lies off its neighbours. The filter steps from
        plot to plot, however irregular these come, and at most {MAX_STEP:g} s at once; gaps of up
        to {MAX_GAP:g} s are bridged. The truth is a file{turns * flight} with the columns
        ``t, x_m, y_m, z_m``{turns * axes}. Without a truth the filter misses the last of every
        six stretches of {MISSED:g} s (of a sixth of a shorter window, or of a plot where those
        are rarer), and its error is counted there, against the plots, whose own noise is part of
        it. Episodes are windows of about ``duration`` from the first {low} of the log's time;
        ``kfenv evaluate --plots`` tests on windows of its last half, ``kfenv train`` validates
        between the two. Each begins with a least-squares estimate from the plots of
        {LEARNT:g} s before it. ``rate`` is the log's.""")
