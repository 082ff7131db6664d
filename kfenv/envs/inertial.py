"""The inertial environment: strapdown navigation aided by GNSS."""

from kfenv.envs.tracking import TrackingEnv, TrackingVectorEnv
from kfenv.scenarios.inertial.ins_gnss import InsGnss


class InsGnssEnv(TrackingEnv):
    """An inertial unit aided by GNSS position, velocity and attitude with outliers.

    ## Description
    A vehicle's inertial unit measures specific force and angular rate a hundred times a
    second, with white noise and biases; the filter integrates them (strapdown
    mechanisation). Ten times a second GNSS with several antennas tells position, velocity
    and attitude. Faults give its fixes outliers, more noise or gaps, tell the filter a
    wrong noise level, and make the inertial unit itself go wrong. The agent turns the
    knobs of the filter, which must then trust GNSS or the unit more than it does.

    Every random thing (truth, faults, noise) is drawn before the filter runs, so that
    the action changes the filter and never the world. The filter is a square-root
    sigma-point filter with the exact Joseph form; it does not estimate the unit's biases,
    its process noise stands for them. Before each decision the agent sees the
    innovation of the *pending* fix, formed with nominal knobs; the step then
    applies the knobs to that fix, updates, and predicts to the next one.

    The frame is local: north, east, down, flat, gravity 9.81 m/s^2; Earth rotation and
    transport rate are neglected. Body axes are forward, right, down.

    With ``log`` the filter runs on a real log instead: a window of it an episode, at first
    aligned by gravity and the course. Without attitude in it, the groups are position and
    velocity, and there is one knob less, and there are eight features less. A window's
    first fix gives the initial state and is spent: nothing is pending at the first decision.
    Fixes are moved along their velocity to the nearest decision.

    ``info`` holds, after ``reset`` and every ``step``: ``time`` (s) of the filter step made
    last, its ``estimate`` (9 states: position and velocity north, east and down in m and
    m/s; roll, pitch and yaw in rad), ``position_error`` (m) and ``nis`` (0 where no fix
    came); of the measurement that is pending ``innovation`` and ``innovation_variance`` (m,
    m/s or rad, and their squares; zero and infinite in channels that are missing and at the
    episode's end) and ``noise`` (the standard deviations
    that the filter is told); where the truth is known ``truth`` and ``nees`` (of the
    position, 3 degrees of freedom); after a step ``knobs``, the factors applied.

    ## Action Space
    ``Box(-1, 1, (5,), float32)``, one component a per knob, less where ``actions``
    exposes less. The factor is high^a for a >= 0 and low^-a for a < 0, so that zero is
    the nominal filter. Values beyond the space are taken to its edge.

    | Knob           | Range        | Meaning                                                   |
    |----------------|--------------|-----------------------------------------------------------|
    | fading         | 0.5 to 10    | multiplies the propagated covariance, before its noise,   |
    |                |              | once per period of the fixes                              |
    | process_noise  | 1e-3 to 1e4  | multiplies the covariance of the process noise            |
    | position_noise | 0.05 to 500  | multiplies the standard deviation of the fix's position   |
    | velocity_noise | 0.05 to 500  | the same for velocity                                     |
    | attitude_noise | 0.05 to 500  | the same for attitude                                     |

    With a Gaussian sum as ``filter`` there is a sixth, ``outlier_weight`` (1e-3 to 1e3),
    which multiplies the odds that it gives an outlier.

    ## Observation Space
    ``Box(float32)`` of 29 components with all knobs, all dimensionless: seven for each of
    the groups position, velocity and attitude (first, second and third index), three
    common ones, and the previous action. Nothing in it needs the truth. Windows are
    exponential; logarithms are natural; the space bounds all components by -10 and 10,
    the previous action by -1 and 1. The features of the present (the
    first and the last two of a group) are zero where the group is missing or nothing
    is pending.

    | Index       | Meaning                                                      | Bounds    |
    |-------------|--------------------------------------------------------------|-----------|
    | 0, 7, 14    | whitened innovation w now, its sum over the group's channels | -10 to 10 |
    |             | over the root of their number: sign(w) log(1 + abs(w))       |           |
    | 1, 8, 15    | log of the RMS of w over a window of 3 arrivals              | -10 to 10 |
    | 2, 9, 16    | the same over 10 arrivals                                    | -10 to 10 |
    | 3, 10, 17   | the same over 30 arrivals                                    | -10 to 10 |
    | 4, 11, 18   | lag-1 correlation of w over 30 arrivals                      | -1 to 1   |
    | 5, 12, 19   | share of the group's channels that arrived                   | 0 to 1    |
    | 6, 13, 20   | share of the told noise in the innovation's variance         | 0 to 1    |
    | 21          | log(1 + seconds since anything arrived)                      | 0 to 10   |
    | 22          | log of the predicted position deviation over the error scale | -10 to 10 |
    | 23          | log of the predicted velocity deviation over a tenth of the  | -10 to 10 |
    |             | error scale per second                                       |           |
    | 24 to 28    | the previous action, one component per exposed knob          | -1 to 1   |

    Deviations are roots of the trace of the covariance predicted with nominal knobs.
    ``env.unwrapped.core.feature_names()`` names every component.

    ## Rewards
    The error scale is 20 m. Errors are those of the position, m, over the filter
    steps of one decision.

    - ``"rmse"`` (default): minus the RMS error over the error scale, at least -10.
    - ``"improvement"``: log of the RMS error of a nominal filter on the same measurements
      over this filter's, between -3 and 3; of less variance, for training.

    A lost track costs the cap (10 or 3) for that decision and each that remained, so that
    losing it never pays. Without truth, and with the track kept, the reward is zero.
    With a ``log`` of two files, errors are the distances to the fixes that faults withhold
    from the filter, and nothing else counts; ``position_error`` is the latest of a decision,
    and it and ``nees`` are left out where there is none (NaN in the vector environment).

    ## Starting State
    The flight is random: straight legs, coordinated turns of 2 to 10 deg/s, climbs and
    changes of speed, 35 to 140 m/s, 150 to 3000 m high; or the published one with
    ``faults="paper"``: 270 m/s, a bank of 45 deg that swings to the other side and back in
    50 s. The initial estimate is drawn about the truth with standard deviations 50 m,
    2 m/s and 2 deg per axis, which the filter knows.

    The first decision concerns the fix at the first instant, which updates the
    initial state without a prediction.

    ## Episode End
    Terminated when the track is lost: a position error above 10 km, or a filter that
    fails (numbers that are not finite). Truncated after the last instant, which is after
    duration * rate + 1 filter steps (5001 by default).

    ## Arguments
    - ``duration``: of an episode, s. Default 50; random flights last at most 600.
    - ``rate``: inertial samples, which are filter steps, per second, 1 to 100 (default 100).
    - ``measurement_rate``: fixes per second (default 10), a divisor of ``rate``; where it is more
      than that, a fix falls on every sample.
    - ``gnss_noise``: standard deviations of a fix's position (m), velocity (m/s) and
      attitude (deg) per axis, default (70, 2, 0.9): like ``process_noise`` not the
      paper's table, but chosen for the errors that the reproduction (E6) is compared with.
    - ``imu_noise``: white noise of a sample at 100 Hz, m/s^2 and deg/s, default (0.3, 0.3);
      at another rate its density is the same.
    - ``imu_bias``: standard deviations of the biases, m/s^2 and deg/s, drawn per axis and
      episode, default (0.1, 0.1); with ``faults="paper"`` the biases themselves.
    - ``imu_instability``: standard deviations of biases that wander with a correlation time
      of 100 s, m/s^2 and deg/s, default (0, 0).
    - ``process_noise``: what the filter believes of the errors that the samples bring into
      position (m), velocity (m/s) and attitude (deg): standard deviations after a second,
      default (5, 3, 0.25).
    - ``log``: paths of CSV files to run on, ``(IMU, GNSS)`` or ``(IMU, GNSS, TRUTH)``, one
      clock, columns by name (`kfenv.scenarios.inertial.files`). IMU: ``t`` s, ``fx, fy, fz``
      m/s^2, ``wx, wy, wz`` rad/s, axes forward, right, down. GNSS: ``t, lat, lon`` deg,
      ``height`` m, ``vn, ve, vd`` m/s and the deviations ``sd_n, sd_e, sd_d, sd_vn, sd_ve,
      sd_vd``. TRUTH: the first seven of these. Samples are averaged to ``rate``; the fixes
      set ``measurement_rate``; ``process_noise`` should suit the unit. Episodes are windows
      of the log's first 30 %; contests validate on the next 20 % and test on the rest, on
      windows and faults that no seed changes.
    - ``faults``: what spoils an episode.

      - ``"random"`` (default; with a ``log`` as ``"outages"``): at most one jamming burst of
        3 to 10 s that raises the noise of all fixes 2 to 10 times; one to three bursts of
        interference of 4 to 15 s in which 5 to 60 % of the fixes, or of their numbers, are
        outliers of 3 to 22 times the noise; a signal loss of 2 to 8 s; in half of the
        episodes glint, one fix in ten with 8 times the noise; a misreported noise level,
        0.4 to 2.5 times the true one in each channel; and in half of the episodes each a
        step of 0.5 to 5 m/s^2 in the specific force and one of 0.5 to 3 deg/s in the angular
        rate, for 3 to 12 s along one axis.
      - ``"outages"``: a signal loss of 5 to 15 s.
      - ``"paper"``: the published case, 15 % outliers of 500 times the variance from 7 to
        26 s.
      - ``"none"``.
      - a mapping from names to parameters, e.g. ``{"outliers": {"duration": 10}}``. Names:
        ``outliers`` (start s, duration s, share, variance_ratio, by: "vector" or
        "channel"), ``interference`` (bursts, duration s, share, factor, by: also "either"),
        ``acceleration_step`` (probability, size m/s^2, duration s, start s, axes),
        ``rate_step`` (the same, size deg/s), ``jamming`` (bursts, duration s, factor, start
        s), ``signal_loss`` (duration s, start s), ``glint`` (probability, fraction,
        factor), ``noise_misreport`` (factor).
      - a list of such objects from `kfenv.scenarios.faults` and
        `kfenv.scenarios.inertial.faults`, or of one's own: anything with a ``label`` and a
        method ``apply(draft, rng)``; ``draft.motion_inputs`` holds the samples.

    - ``reward``: ``"rmse"`` or ``"improvement"``, see Rewards.
    - ``actions``: names of the knobs to expose, from the table above;
      ``"measurement_noise"`` stands for the three noise knobs. Default all.
    - ``recording``: a `kfenv.scenarios.recording.Recording` to replay instead of drawing
      episodes, one after the other; a seeded ``reset`` starts again at the first. Its
      times take the place of ``duration`` and ``rate``, and faults are not used. How far its
      fixes lie apart is not looked at: give ``rate`` and ``measurement_rate`` as it has them,
      by which fading and the default ``decision_interval`` go.
    - ``decision_interval``: filter steps for which an action holds, 1 or more; by default
      those from one fix to the next (10), so that every decision concerns one fix.
    - ``filter``: ``"srukf-joseph-exact"`` (default, compiled); a square-root design of
      `kfenv.filters.designs`, e.g. ``"srckf-joseph-exact"``, slow; or the Gaussian sums
      ``"gsekf"`` and ``"gsckf"``, which are told the published mixture.
    - ``kappa``: spread of the sigma points, 0 or more (default 1).
    - ``render_mode``: ``"rgb_array"``, ``"human"`` or None (default).

    The vector environment also takes ``num_envs`` and ``autoreset_mode``
    (``"next_step"``, ``"same_step"`` or ``"disabled"``), and does not render.

    ## Version History
    - v0: initial version.
    """

    scenario_class = InsGnss


class InsGnssVectorEnv(TrackingVectorEnv):
    """Many `InsGnssEnv` in lock-step over one compiled filter, see there.

    Takes ``num_envs`` and ``autoreset_mode`` (``"next_step"`` by default, ``"same_step"``
    for libraries that expect a fresh observation at once, ``"disabled"``) and every argument
    of the single environment but ``render_mode``. Sub-environment i seeded with s + i gives
    the same bits as a single environment seeded so; of a ``recording`` it replays the
    episodes i, i + num_envs, and so on. An episode of 50 s takes 1.3 MB.
    """

    scenario_class = InsGnss
