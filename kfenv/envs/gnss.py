"""The satellite navigation environment."""

from kfenv.envs.tracking import TrackingEnv, TrackingVectorEnv
from kfenv.scenarios.gnss.tracking import GnssTracking


class GnssTrackingEnv(TrackingEnv):
    """An aircraft located by satellites while its receiver is jammed, spoofed and loses lock.

    ## Description
    A receiver on an aircraft measures pseudoranges and their rates to the satellites above
    10 deg, up to twelve, once a second; the filter runs at ten steps a second. Their noise
    is 3 m and 0.06 m/s: code noise, multipath by elevation and what the corrections leave
    of the troposphere. Faults make the receiver's clock jitter, take all satellites away,
    draw single satellites aside, raise the noise, and make the receiver tell the filter a
    wrong noise level. The agent turns the knobs of the filter that tracks.

    Every random thing (truth, faults, noise) is drawn before the filter runs, so that
    the action changes the filter and never the world. The filter is a square-root
    sigma-point filter with the exact Joseph form; its motion model is the variable turn
    with a white jerk of 1 m^2/s^5 per axis, beside a clock whose drift is driven by white
    noise of 0.1 (m/s)^2/s. Before each decision the agent sees the innovation of the
    *pending* measurement, formed with nominal knobs; the step then applies the knobs to
    that measurement, updates, and predicts to the next one.

    A channel follows one satellite for as long as it is visible, so that others rise and
    set without disturbing it; free channels go to the highest satellite without one.
    Satellite clocks and the standard troposphere and ionosphere are taken off the
    pseudoranges; the wet delay's random walk stays (1 cm in an hour).

    ``info`` holds, after ``reset`` and every ``step``: ``time`` (s) of the update made
    last, its ``estimate`` (11 states: position, velocity and acceleration along x, y, z of
    the earth-fixed WGS84 frame; m, m/s, m/s^2; clock bias, m, and drift, m/s),
    ``position_error`` (m) and ``nis`` (0 if nothing arrived); of the measurement that is
    pending ``innovation`` and ``innovation_variance`` (m or m/s, 12 pseudoranges and then
    12 rates; zero and infinite in channels that are missing and at the episode's end) and
    ``noise`` (the standard deviations that the filter is told); where the truth is known
    ``truth`` and ``nees`` (of the position, 3 degrees of freedom); after a step ``knobs``,
    the factors applied.

    ## Action Space
    ``Box(-1, 1, (4,), float32)``, one component a per knob, less where ``actions``
    exposes less. The factor is high^a for a >= 0 and low^-a for a < 0, so that zero is
    the nominal filter. Values beyond the space are taken to its edge. A knob serves all
    satellites: a single one cannot be left out.

    | Knob              | Range        | Meaning                                                  |
    |-------------------|--------------|----------------------------------------------------------|
    | fading            | 0.5 to 10    | multiplies the propagated covariance, before its noise   |
    | process_noise     | 1e-3 to 1e4  | multiplies the covariance of the process noise           |
    | pseudorange_noise | 0.05 to 500  | multiplies the standard deviation of the pseudoranges    |
    | rate_noise        | 0.05 to 500  | the same for their rates                                 |

    ## Observation Space
    ``Box(float32)`` of 21 components with all knobs, all dimensionless: seven for each of
    the groups pseudorange and rate (first and second index), three common ones, and the
    previous action. Nothing in it needs the truth. Windows are exponential; logarithms are
    natural; the space bounds all components by -10 and 10, the previous action by -1
    and 1. The features of the present (the first and the last two of a group) are zero
    where no satellite is received or nothing is pending. The whitened innovation of a
    group is the sum over its channels that arrived, over the root of their number; squares
    and shares are means over them.

    | Index    | Meaning                                                         | Bounds    |
    |----------|-----------------------------------------------------------------|-----------|
    | 0, 7     | whitened innovation w now: sign(w) log(1 + abs(w))              | -10 to 10 |
    | 1, 8     | log of the RMS of w over a window of 3 arrivals                 | -10 to 10 |
    | 2, 9     | the same over 10 arrivals                                       | -10 to 10 |
    | 3, 10    | the same over 30 arrivals                                       | -10 to 10 |
    | 4, 11    | lag-1 correlation of w over 30 arrivals                         | -1 to 1   |
    | 5, 12    | share of the twelve channels that arrived                       | 0 to 1    |
    | 6, 13    | share of the told noise in the innovation's variance            | 0 to 1    |
    | 14       | log(1 + seconds since anything arrived)                         | 0 to 10   |
    | 15       | log of the predicted position deviation over the error scale    | -10 to 10 |
    | 16       | log of the predicted velocity deviation over a tenth of the     | -10 to 10 |
    |          | error scale per second                                          |           |
    | 17 to 20 | the previous action, one component per exposed knob             | -1 to 1   |

    Deviations are roots of the trace of the covariance predicted with nominal knobs.
    ``env.unwrapped.core.feature_names()`` names every component.

    ## Rewards
    The error scale is 10 m. Errors are those of the position, m, over the filter
    steps of one decision.

    - ``"rmse"`` (default): minus the RMS error over the error scale, at least -10.
    - ``"improvement"``: log of the RMS error of a nominal filter on the same measurements
      over this filter's, between -3 and 3; of less variance, for training.

    A lost track costs the cap (10 or 3) for that decision and each that remained, so that
    losing it never pays. Without truth, and with the track kept, the reward is zero.

    ## Starting State
    The flight is random: straight legs, turns of 2 to 10 deg/s, climbs and changes of
    speed, 35 to 140 m/s, 150 to 3000 m above ``place`` and within 17 km of it; trajectory B
    of the paper with ``faults="paper"``; or a window of ``track``. The time of day is
    random too, unless ``date`` tells it. The initial estimate is drawn about the truth with
    standard deviations 50 m, 20 m/s and 3 m/s^2 per axis, 150 m of the clock's bias and
    5 m/s of its drift, which the filter knows.

    The first decision concerns the measurement at the first instant, which updates the
    initial state without a prediction.

    ## Episode End
    Terminated when the track is lost: a position error above 10 km, or a filter that
    fails (numbers that are not finite). Truncated after the last instant, which is after
    duration * rate + 1 filter steps (1201 by default).

    ## Arguments
    - ``duration``: of an episode, s. Default 120, or 250 with ``faults="paper"``; random
      flights last at most 600.
    - ``rate``: filter steps per second, 1 to 100 (default 10).
    - ``measurement_rate``: measurements per second (default 1); must divide ``rate``.
    - ``faults``: what spoils an episode.

      - ``"random"`` (default), each starting at random: up to two jamming bursts of 5 to
        25 s that raise all noise 2 to 31 times; a clock that jitters by 15 to 150 m for 10
        to 30 s; a PLL failure of 2 to 8 s without any satellite; a step of 5 to 50 m in
        one satellite's pseudorange for 10 to 40 s, and a ramp of 0.1 to 1 m/s for 20 to
        60 s, as by a spoofer; a multipath burst of 5 to 30 s that raises the pseudorange
        noise below 30 deg 3 to 30 times; and a misreported noise level, 0.4 to 2.5 times
        the true one in each group.
      - ``"paper"``: the published case. Trajectory B at five in the morning (six
        satellites in view), a clock that jitters by 150 m and 5 m/s from 70 to 100 s,
        unknown to the filter, and a PLL failure from 150 to 165 s.
      - ``"none"``.
      - a mapping from names to parameters, e.g. ``{"range_step": {"start": 70, "size":
        [50, 50]}}``. Names: ``clock_degradation`` (duration s, range_error m, start s),
        ``pll_failure`` (duration s, start s), ``range_step`` (duration s, size m, start s),
        ``range_ramp`` (duration s, rate m/s, start s), ``multipath_burst`` (duration s,
        factor, below deg, start s), ``noise_misreport`` (factor), ``jamming`` (bursts,
        duration s, factor, start s), ``signal_loss`` (duration s, start s), ``glint``
        (probability, fraction, factor).
      - a list of such objects from `kfenv.scenarios.faults` and
        `kfenv.scenarios.gnss.faults`, or of one's own: anything with a ``label`` and a
        method ``apply(draft, rng)``.

      The true noise that the clairvoyant agent knows is each channel's own. It does not
      know of a clock's jitter, which is common to all satellites, nor of steps and ramps.
    - ``place``: latitude and longitude (deg) and height (m) of the flights' origin
      (default 45.2, 7.6, 0).
    - ``date``: a day such as ``"2016-02-29"`` (default), at a random time of which each
      episode begins, or the instant at which all begin, such as ``"2016-02-29T05:00"``;
      GPS time.
    - ``almanac``: path of a YUMA almanac file, whose healthy satellites are used at
      ``date``; by default the published baseline constellation of 24 slots.
    - ``mask``: elevation above which satellites are used, deg (default 10).
    - ``ionosphere``: share of Klobuchar's ionospheric delay that the corrections leave, -1
      to 1 (default 0; 0.5 is usual). The filter is not told.
    - ``track``: path of a CSV file with the columns t (s), lat, lon (degrees) and alt_m (m)
      of a real flight, which becomes the truth: a random window of it, where it was flown.
    - ``rinex``: paths of a RINEX 2 or 3 observation file and its navigation file, in place of
      all that is simulated: GPS on L1 of a receiver that stood still at the position in the
      header, which is the truth. Pseudoranges are cleared of satellite clocks, group delay,
      relativity, troposphere and Klobuchar's ionosphere; rates are the Doppler's, where
      there is any. The told noise is the error budget, with half of the ionosphere's delay
      added. Filter steps are at most 1 s long, from epoch to epoch; the motion model is
      constant acceleration, since a receiver at rest has no turn rate, and is not told that
      the receiver rests: to tune for one that moves, expose the noise knobs alone. Episodes
      are windows of ``duration`` (300 by default) from the first 30 % of the log's time;
      ``kfenv evaluate --rinex`` tests on windows of its last half, ``kfenv train``
      validates between the two. Each window starts with the least-squares fix of its
      first epoch, whose measurement is then spent. ``rate`` is the log's, and only
      ``duration`` goes with it.
    - ``reward``: ``"rmse"`` or ``"improvement"``, see Rewards.
    - ``actions``: names of the knobs to expose, from the table above;
      ``"measurement_noise"`` stands for the two noise knobs. Default all.
    - ``recording``: a `kfenv.scenarios.recording.Recording` to replay instead of drawing
      episodes, one after the other; a seeded ``reset`` starts again at the first. Its
      times take the place of ``duration`` and ``rate``, and faults and track are not used.
      Channels and inputs are those of `kfenv.models.gnss.pseudorange.pseudoranges`. How far
      its measurements lie apart is not looked at: give ``rate`` and ``measurement_rate`` as
      it has them (or its ``rinex``), by which fading and the default ``decision_interval`` go.
    - ``decision_interval``: filter steps for which an action holds, 1 or more; by default
      those from one measurement to the next (10; with ``rinex`` those between epochs), so
      that every decision concerns one measurement, but for a log's first, whose measurement
      is spent. Fading acts at the instants of measurements alone.
    - ``filter``: ``"srukf-joseph-exact"`` (default, compiled), or a square-root design of
      `kfenv.filters.designs`, e.g. ``"srukf-joseph"`` with the Jacobian at the posterior
      as published or ``"srukf-joseph-prior"`` at the prediction; those are slow.
    - ``kappa``: spread of the sigma points, 0 or more (default 1).
    - ``render_mode``: ``"rgb_array"``, ``"human"`` or None (default). Pictures are drawn
      east, north and up about the first estimate.

    The vector environment also takes ``num_envs`` and ``autoreset_mode``
    (``"next_step"``, ``"same_step"`` or ``"disabled"``), and does not render. Each
    sub-environment holds its episode, 3 MB by default.

    ## Version History
    - v0: initial version.
    """

    scenario_class = GnssTracking


class GnssTrackingVectorEnv(TrackingVectorEnv):
    """Many `GnssTrackingEnv` in lock-step over one compiled filter, see there.

    Takes ``num_envs`` and ``autoreset_mode`` (``"next_step"`` by default, ``"same_step"``
    for libraries that expect a fresh observation at once, ``"disabled"``) and every argument
    of the single environment but ``render_mode``. Sub-environment i seeded with s + i gives
    the same bits as a single environment seeded so; of a ``recording`` it replays the
    episodes i, i + num_envs, and so on.
    """

    scenario_class = GnssTracking
