"""Bistatic tracking: positions measured from reflections of GPS signals (Lazarov et al.)."""

from kfenv.envs.tracking import TrackingEnv, TrackingVectorEnv
from kfenv.scenarios.radar.bistatic import BistaticTracking


class BistaticTrackingEnv(TrackingEnv):
    """A target whose position is measured from the GPS signals that it reflects.

    ## Description
    Twice a second the position of one target is solved from reflections of GPS signals:
    x, y and z with noise of variance 10, 8 and 5 m^2. The target moves as a Wiener process
    in the acceleration of each axis. Faults raise the noise, take measurements away, and
    make the sensor tell the filter a wrong noise level. The agent turns the knobs of the
    filter that tracks.

    Every random thing (truth, faults, noise) is drawn before the filter runs, so that
    the action changes the filter and never the world. The filter is a square-root
    sigma-point filter with the exact Joseph form; its motion model is that of the truth,
    constant acceleration with a white jerk of 0.2 m^2/s^5 per axis. Both models are linear,
    so that with nominal knobs it is the Kalman filter. Before each decision the agent sees
    the innovation of the *pending* measurement, formed with nominal knobs; the step then
    applies the knobs to that measurement, updates, and predicts to the next one.

    ``info`` holds, after ``reset`` and every ``step``: ``time`` (s) of the update made
    last, its ``estimate`` (9 states: position, velocity and acceleration along x, y, z;
    m, m/s, m/s^2), ``position_error`` (m) and ``nis`` (0 if nothing arrived); of
    the measurement that is pending ``innovation`` and ``innovation_variance`` (m and m^2;
    zero and infinite in channels that are missing and at the episode's end) and ``noise``
    (the standard deviations that the filter is told); where the truth is known ``truth``
    and ``nees`` (of the position, 3 degrees of freedom); after a step ``knobs``, the
    factors applied.

    ## Action Space
    ``Box(-1, 1, (5,), float32)``, one component a per knob, less where ``actions``
    exposes less. The factor is high^a for a >= 0 and low^-a for a < 0, so that zero is
    the nominal filter. Values beyond the space are taken to its edge.

    | Knob            | Range        | Meaning                                                   |
    |-----------------|--------------|-----------------------------------------------------------|
    | fading          | 0.5 to 10    | multiplies the propagated covariance, before its noise    |
    | process_noise   | 1e-3 to 1e4  | multiplies the covariance of the process noise            |
    | x_noise         | 0.05 to 500  | multiplies the standard deviation of the noise of x       |
    | y_noise         | 0.05 to 500  | the same for y                                            |
    | z_noise         | 0.05 to 500  | the same for z                                            |

    ## Observation Space
    ``Box(float32)`` of 29 components with all knobs, all dimensionless: seven for each of
    the groups x, y and z (first, second and third index), three common ones, and the
    previous action. Nothing in it needs the truth. Windows are exponential; logarithms are
    natural; the space bounds all components by -10 and 10, the previous action by -1 and 1.
    The features of the present (the first and the last two of a group) are zero where the
    channel is missing or nothing is pending.

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
    The error scale is 10 m. Errors are those of the position, m, over the filter
    steps of one decision.

    - ``"rmse"`` (default): minus the RMS error over the error scale, at least -10.
    - ``"improvement"``: log of the RMS error of a nominal filter on the same measurements
      over this filter's, between -3 and 3; of less variance, for training.

    A lost track costs the cap (10 or 3) for that decision and each that remained, so that
    losing it never pays. Without truth, and with the track kept, the reward is zero.

    ## Starting State
    The target rests at the origin, and is carried off by the process: after a minute it is
    some 4 km away and flies at 180 m/s. (The filter is linear: its errors do not depend on
    where the target is, nor on how fast.) The initial estimate is drawn about the truth
    with standard deviations 0.316 m, 0.316 m/s and 0.707 m/s^2 per axis, which the filter
    knows; in the published case it is the truth.

    The first decision concerns the measurement at the first instant, which updates the
    initial state without a prediction.

    ## Episode End
    Terminated when the track is lost: a position error above 1 km, or a filter that
    fails (numbers that are not finite). Truncated after the last instant, which is after
    duration * rate + 1 filter steps (121 by default).

    ## Arguments
    - ``duration``: of an episode, s. Default 60, or 24.5 with ``faults="paper"``.
    - ``rate``: measurements per second, 1 to 100 (default 2).
    - ``faults``: what spoils an episode.

      - ``"random"`` (default): one to three jamming bursts of 5 to 25 s that raise the noise
        2 to 31 times; a signal loss of 2 to 8 s; in half of the episodes glint, one
        measurement in ten with 8 times the noise; and a misreported noise level, 0.4 to 2.5
        times the true one in each channel.
      - ``"paper"``: the published case, 50 measurements without a fault, the initial state
        known.
      - ``"none"``.
      - a mapping from names to parameters, e.g. ``{"jamming": {"start": 20, "bursts":
        [1, 1]}}``. Names: ``jamming`` (bursts, duration s, factor, start s),
        ``signal_loss`` (duration s, start s), ``glint`` (probability, fraction, factor),
        ``noise_misreport`` (factor).
      - a list of such objects from `kfenv.scenarios.faults`, or of one's own: anything with
        a ``label`` and a method ``apply(draft, rng)``.

    - ``reward``: ``"rmse"`` or ``"improvement"``, see Rewards.
    - ``actions``: names of the knobs to expose, from the table above;
      ``"measurement_noise"`` stands for the three noise knobs. Default all.
    - ``recording``: a `kfenv.scenarios.recording.Recording` to replay instead of drawing
      episodes, one after the other; a seeded ``reset`` starts again at the first. Its
      times take the place of ``duration`` and ``rate``, and faults are not used.
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

    scenario_class = BistaticTracking


class BistaticTrackingVectorEnv(TrackingVectorEnv):
    """Many `BistaticTrackingEnv` in lock-step over one compiled filter, see there.

    Takes ``num_envs`` and ``autoreset_mode`` (``"next_step"`` by default, ``"same_step"``
    for libraries that expect a fresh observation at once, ``"disabled"``) and every argument
    of the single environment but ``render_mode``. Sub-environment i seeded with s + i gives
    the same bits as a single environment seeded so; of a ``recording`` it replays the
    episodes i, i + num_envs, and so on.
    """

    scenario_class = BistaticTracking
