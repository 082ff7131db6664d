"""The radar environments: tracking under faults, and the published validation case."""

from kfenv.envs.tracking import TrackingEnv, TrackingVectorEnv
from kfenv.scenarios.radar.tracking import RadarTracking
from kfenv.scenarios.radar.validation import RadarValidation


class RadarTrackingEnv(TrackingEnv):
    """A manoeuvring aircraft before a phased-array radar that is jammed and misreports.

    ## Description
    A radar at the origin measures range, azimuth (clockwise from north) and elevation of
    one aircraft within 17 km, ten times a second. Its noise follows from the radar
    equation: 0.04 m and 0.05 deg at 10 km on broadside, more with distance, scan angle
    and rain. Faults raise the noise, take measurements away, and make the radar tell the
    filter a wrong noise level. The agent turns the knobs of the filter that tracks.

    Every random thing (truth, faults, noise) is drawn before the filter runs, so that
    the action changes the filter and never the world. The filter is a square-root
    sigma-point filter with the exact Joseph form; its motion model is the variable turn
    with a white jerk of 1 m^2/s^5 per axis. Before each decision the agent sees the
    innovation of the *pending* measurement, formed with nominal knobs; the step then
    applies the knobs to that measurement, updates, and predicts to the next one.

    ``info`` holds, after ``reset`` and every ``step``: ``time`` (s) of the update made
    last, its ``estimate`` (9 states: position, velocity and acceleration along x east,
    y north, z up; m, m/s, m/s^2), ``position_error`` (m) and ``nis`` (0 if nothing arrived);
    of the measurement that is pending ``innovation`` and ``innovation_variance`` (m or rad;
    zero and infinite in channels that are missing and at the episode's end) and ``noise``
    (the standard deviations that the filter is told); where the truth is known ``truth`` and
    ``nees`` (of the position, 3 degrees of freedom); after a step ``knobs``, the factors applied.

    ## Action Space
    ``Box(-1, 1, (5,), float32)``, one component a per knob, less where ``actions``
    exposes less. The factor is high^a for a >= 0 and low^-a for a < 0, so that zero is
    the nominal filter. Values beyond the space are taken to its edge.

    | Knob            | Range        | Meaning                                                   |
    |-----------------|--------------|-----------------------------------------------------------|
    | fading          | 0.5 to 10    | multiplies the propagated covariance, before its noise    |
    | process_noise   | 1e-3 to 1e4  | multiplies the covariance of the process noise            |
    | range_noise     | 0.05 to 500  | multiplies the standard deviation of the range noise      |
    | azimuth_noise   | 0.05 to 500  | the same for azimuth                                      |
    | elevation_noise | 0.05 to 500  | the same for elevation                                    |

    ## Observation Space
    ``Box(float32)`` of 29 components with all knobs, all dimensionless: seven for each of
    the groups range, azimuth and elevation (first, second and third index), three
    common ones, and the previous action. Nothing in it needs the truth. Windows are
    exponential; logarithms are natural; the space bounds all components by -10 and 10,
    the previous action by -1 and 1. The features of the present (the
    first and the last two of a group) are zero where the channel is missing or nothing
    is pending.

    | Index       | Meaning                                                      | Bounds    |
    |-------------|--------------------------------------------------------------|-----------|
    | 0, 7, 14    | whitened innovation w now: sign(w) log(1 + abs(w))           | -10 to 10 |
    | 1, 8, 15    | log of the RMS of w over a window of 3 arrivals              | -10 to 10 |
    | 2, 9, 16    | the same over 10 arrivals                                    | -10 to 10 |
    | 3, 10, 17   | the same over 30 arrivals                                    | -10 to 10 |
    | 4, 11, 18   | lag-1 correlation of w over 30 arrivals                      | -1 to 1   |
    | 5, 12, 19   | whether the channel arrived                                  | 0 or 1    |
    | 6, 13, 20   | share of the told noise in the innovation's variance         | 0 to 1    |
    | 21          | log(1 + seconds since anything arrived)                      | 0 to 10   |
    | 22          | log of the predicted position deviation over the error scale | -10 to 10 |
    | 23          | log of the predicted velocity deviation over a tenth of the  | -10 to 10 |
    |             | error scale per second                                       |           |
    | 24 to 28    | the previous action, one component per exposed knob          | -1 to 1   |

    Deviations are roots of the trace of the covariance predicted with nominal knobs.
    ``env.unwrapped.core.feature_names()`` names every component.

    ## Rewards
    The error scale is 50 m. Errors are those of the position, m, over the filter
    steps of one decision.

    - ``"rmse"`` (default): minus the RMS error over the error scale, at least -10.
    - ``"improvement"``: log of the RMS error of a nominal filter on the same measurements
      over this filter's, between -3 and 3; of less variance, for training.

    A lost track costs the cap (10 or 3) for that decision and each that remained, so that
    losing it never pays. Without truth, and with the track kept, the reward is zero.

    ## Starting State
    The flight is random: straight legs, turns of 2 to 10 deg/s, climbs and changes of
    speed, 35 to 140 m/s, 150 to 3000 m high and within coverage (1.5 to 17 km, 55 deg off
    a broadside 20 deg above north); trajectory B of the paper with ``faults="paper"``; or
    a window of ``track``. The initial estimate is drawn about the truth with standard
    deviations 50 m, 20 m/s and 3 m/s^2 per axis, which the filter knows.

    The first decision concerns the measurement at the first instant, which updates the
    initial state without a prediction.

    ## Episode End
    Terminated when the track is lost: a position error above 10 km, or a filter that
    fails (numbers that are not finite). Truncated after the last instant, which is after
    duration * rate + 1 filter steps (1201 by default).

    ## Arguments
    - ``duration``: of an episode, s. Default 120, or 250 with ``faults="paper"``; random
      flights last at most 600.
    - ``rate``: measurements per second, 1 to 100 (default 10; 2 is the harder contest).
    - ``faults``: what spoils an episode.

      - ``"random"`` (default): rain of up to 50 mm/h; one to three jamming bursts of 5 to
        25 s that raise the noise 2 to 31 times; a signal loss of 2 to 8 s; in half of the
        episodes glint, one measurement in ten with 8 times the noise; and a misreported
        noise level, 0.4 to 2.5 times the true one in each channel.
      - ``"paper"``: the published case. Trajectory B, a self-screening jammer from 70 to
        100 s of whose noise the filter is told, and a signal loss from 150 to 160 s.
      - ``"none"``.
      - a mapping from names to parameters, e.g. ``{"jamming": {"start": 70, "bursts":
        [1, 1]}}``. Names: ``jamming`` (bursts, duration s, factor, start s),
        ``signal_loss`` (duration s, start s), ``glint`` (probability, fraction, factor),
        ``noise_misreport`` (factor), ``rain`` (rate mm/h), ``self_screening_jammer``
        (start s, duration s, known).
      - a list of such objects from `kfenv.scenarios.faults` and
        `kfenv.scenarios.radar.scenario`, or
        of one's own: anything with a ``label`` and a method ``apply(draft, rng)``.

    - ``track``: path of a CSV file with the columns t (s), lat, lon (degrees) and alt_m (m)
      of a real flight, which becomes the truth: by default a random window of it, placed
      at random before the radar.
    - ``radar_position``: latitude and longitude (degrees) and height (m) of the radar beside
      that flight; without it the window is placed at random.
    - ``reward``: ``"rmse"`` or ``"improvement"``, see Rewards.
    - ``actions``: names of the knobs to expose, from the table above;
      ``"measurement_noise"`` stands for the three noise knobs. Default all.
    - ``recording``: a `kfenv.scenarios.recording.Recording` to replay instead of drawing
      episodes, one after the other; a seeded ``reset`` starts again at the first. Its
      times take the place of ``duration`` and ``rate``, and faults and track are not used.
    - ``decision_interval``: filter steps for which an action holds, 1 or more (default 1).
    - ``filter``: ``"srukf-joseph-exact"`` (default, compiled), or a square-root design of
      `kfenv.filters.designs`, e.g. ``"srukf-joseph"`` with the Jacobian at the posterior
      as published or ``"srukf-joseph-prior"`` at the prediction; those are slow. The Gaussian
      sums ``"gsekf"`` and ``"gsckf"`` hold 15 % of the measurements for outliers of 500 times
      the variance, and have a knob ``outlier_weight`` (1e-3 to 1e3) on the odds of that.
    - ``kappa``: spread of the sigma points, 0 or more (default 1).
    - ``render_mode``: ``"rgb_array"``, ``"human"`` or None (default).

    The vector environment also takes ``num_envs`` and ``autoreset_mode``
    (``"next_step"``, ``"same_step"`` or ``"disabled"``), and does not render.

    ## Version History
    - v0: initial version.
    """

    scenario_class = RadarTracking


class RadarTrackingVectorEnv(TrackingVectorEnv):
    """Many `RadarTrackingEnv` in lock-step over one compiled filter, see there.

    Takes ``num_envs`` and ``autoreset_mode`` (``"next_step"`` by default, ``"same_step"``
    for libraries that expect a fresh observation at once, ``"disabled"``) and every argument
    of the single environment but ``render_mode``. Sub-environment i seeded with s + i gives
    the same bits as a single environment seeded so; of a ``recording`` it replays the
    episodes i, i + num_envs, and so on.
    """

    scenario_class = RadarTracking


class RadarValidationEnv(TrackingEnv):
    """The published validation case: constant acceleration, fixed radar noise.

    ## Description
    A radar at the origin measures range, azimuth (clockwise from north) and elevation of
    one aircraft with noise of constant deviation: 20 m, 1.45 deg, 1.45 deg at ten
    measurements a second, or 30 m, 1.45 deg, 5 deg at two. The agent turns the knobs of
    the filter that tracks.

    Every random thing (truth, faults, noise) is drawn before the filter runs, so that
    the action changes the filter and never the world. The filter is a square-root
    sigma-point filter with the exact Joseph form; its motion model is constant acceleration
    with a white jerk of 1 m^2/s^5 per axis. Before each decision the agent sees the
    innovation of the *pending* measurement, formed with nominal knobs; the step then
    applies the knobs to that measurement, updates, and predicts to the next one.

    ``info`` holds, after ``reset`` and every ``step``: ``time`` (s) of the update made
    last, its ``estimate`` (9 states: position, velocity and acceleration along x east,
    y north, z up; m, m/s, m/s^2), ``position_error`` (m) and ``nis`` (0 if nothing arrived);
    of the measurement that is pending ``innovation`` and ``innovation_variance`` (m or rad;
    zero and infinite in channels that are missing and at the episode's end) and ``noise``
    (the standard deviations that the filter is told); where the truth is known ``truth`` and
    ``nees`` (of the position, 3 degrees of freedom); after a step ``knobs``, the factors applied.

    ## Action Space
    ``Box(-1, 1, (5,), float32)``, one component a per knob, less where ``actions``
    exposes less. The factor is high^a for a >= 0 and low^-a for a < 0, so that zero is
    the nominal filter. Values beyond the space are taken to its edge.

    | Knob            | Range        | Meaning                                                   |
    |-----------------|--------------|-----------------------------------------------------------|
    | fading          | 0.5 to 10    | multiplies the propagated covariance, before its noise    |
    | process_noise   | 1e-3 to 1e4  | multiplies the covariance of the process noise            |
    | range_noise     | 0.05 to 500  | multiplies the standard deviation of the range noise      |
    | azimuth_noise   | 0.05 to 500  | the same for azimuth                                      |
    | elevation_noise | 0.05 to 500  | the same for elevation                                    |

    ## Observation Space
    ``Box(float32)`` of 29 components with all knobs, all dimensionless: seven for each of
    the groups range, azimuth and elevation (first, second and third index), three
    common ones, and the previous action. Nothing in it needs the truth. Windows are
    exponential; logarithms are natural; the space bounds all components by -10 and 10,
    the previous action by -1 and 1. The features of the present (the
    first and the last two of a group) are zero where the channel is missing or nothing
    is pending.

    | Index       | Meaning                                                      | Bounds    |
    |-------------|--------------------------------------------------------------|-----------|
    | 0, 7, 14    | whitened innovation w now: sign(w) log(1 + abs(w))           | -10 to 10 |
    | 1, 8, 15    | log of the RMS of w over a window of 3 arrivals              | -10 to 10 |
    | 2, 9, 16    | the same over 10 arrivals                                    | -10 to 10 |
    | 3, 10, 17   | the same over 30 arrivals                                    | -10 to 10 |
    | 4, 11, 18   | lag-1 correlation of w over 30 arrivals                      | -1 to 1   |
    | 5, 12, 19   | whether the channel arrived                                  | 0 or 1    |
    | 6, 13, 20   | share of the told noise in the innovation's variance         | 0 to 1    |
    | 21          | log(1 + seconds since anything arrived)                      | 0 to 10   |
    | 22          | log of the predicted position deviation over the error scale | -10 to 10 |
    | 23          | log of the predicted velocity deviation over a tenth of the  | -10 to 10 |
    |             | error scale per second                                       |           |
    | 24 to 28    | the previous action, one component per exposed knob          | -1 to 1   |

    Deviations are roots of the trace of the covariance predicted with nominal knobs.
    ``env.unwrapped.core.feature_names()`` names every component.

    ## Rewards
    The error scale is 100 m. Errors are those of the position, m, over the filter
    steps of one decision.

    - ``"rmse"`` (default): minus the RMS error over the error scale, at least -10.
    - ``"improvement"``: log of the RMS error of a nominal filter on the same measurements
      over this filter's, between -3 and 3; of less variance, for training.

    A lost track costs the cap (10 or 3) for that decision and each that remained, so that
    losing it never pays. Without truth, and with the track kept, the reward is zero.

    ## Starting State
    The flight is trajectory A of the paper (133 m/s, closest approach 922 m at 75 s;
    after 250 s it flies straight on), or a window of ``track``. The initial estimate is
    drawn about the truth with standard deviations 300 m, 30 m/s and 3 m/s^2 per axis,
    which the filter knows.

    The first decision concerns the measurement at the first instant, which updates the
    initial state without a prediction.

    ## Episode End
    Terminated when the track is lost: a position error above 10 km, or a filter that
    fails (numbers that are not finite). Truncated after the last instant, which is after
    duration * rate + 1 filter steps (2501 by default).

    ## Arguments
    - ``duration``: of an episode, s (default 250).
    - ``rate``: measurements per second, 1 to 100 (default 10). Other rates than 10 and 2 need
      ``noise_deviation``.
    - ``noise_deviation``: standard deviations of range (m), azimuth and elevation (degrees);
      by default the published ones of the rate.
    - ``faults``: what spoils an episode.

      - ``"none"`` (default) and ``"paper"``: nothing, as published.
      - ``"random"``: one to three jamming bursts of 5 to 25 s that raise the noise 2 to 31
        times; a signal loss of 2 to 8 s; in half of the episodes glint, one measurement
        in ten with 8 times the noise; and a misreported noise level, 0.4 to 2.5 times the
        true one in each channel.
      - a mapping from names to parameters, e.g. ``{"jamming": {"start": 70, "bursts":
        [1, 1]}}``. Names: ``jamming`` (bursts, duration s, factor, start s),
        ``signal_loss`` (duration s, start s), ``glint`` (probability, fraction, factor),
        ``noise_misreport`` (factor).
      - a list of such objects from `kfenv.scenarios.faults`, or of one's own: anything with
        a ``label`` and a method ``apply(draft, rng)``.

    - ``track``: path of a CSV file with the columns t (s), lat, lon (degrees) and alt_m (m)
      of a real flight, which becomes the truth: by default a random window of it, placed
      at random before the radar.
    - ``radar_position``: latitude and longitude (degrees) and height (m) of the radar beside
      that flight; without it the window is placed at random.
    - ``reward``: ``"rmse"`` or ``"improvement"``, see Rewards.
    - ``actions``: names of the knobs to expose, from the table above;
      ``"measurement_noise"`` stands for the three noise knobs. Default all.
    - ``recording``: a `kfenv.scenarios.recording.Recording` to replay instead of drawing
      episodes, one after the other; a seeded ``reset`` starts again at the first. Its
      times take the place of ``duration`` and ``rate``, and faults and track are not used.
    - ``decision_interval``: filter steps for which an action holds, 1 or more (default 1).
    - ``filter``: ``"srukf-joseph-exact"`` (default, compiled), or a square-root design of
      `kfenv.filters.designs`, e.g. ``"srukf-joseph"`` with the Jacobian at the posterior
      as published or ``"srukf-joseph-prior"`` at the prediction; those are slow. The Gaussian
      sums ``"gsekf"`` and ``"gsckf"`` hold 15 % of the measurements for outliers of 500 times
      the variance, and have a knob ``outlier_weight`` (1e-3 to 1e3) on the odds of that.
    - ``kappa``: spread of the sigma points, 0 or more (default 1).
    - ``render_mode``: ``"rgb_array"``, ``"human"`` or None (default).

    The vector environment also takes ``num_envs`` and ``autoreset_mode``
    (``"next_step"``, ``"same_step"`` or ``"disabled"``), and does not render.

    ## Version History
    - v0: initial version.
    """

    scenario_class = RadarValidation


class RadarValidationVectorEnv(TrackingVectorEnv):
    """Many `RadarValidationEnv` in lock-step over one compiled filter, see there.

    Takes ``num_envs`` and ``autoreset_mode`` (``"next_step"`` by default, ``"same_step"``
    for libraries that expect a fresh observation at once, ``"disabled"``) and every argument
    of the single environment but ``render_mode``. Sub-environment i seeded with s + i gives
    the same bits as a single environment seeded so; of a ``recording`` it replays the
    episodes i, i + num_envs, and so on.
    """

    scenario_class = RadarValidation
