"""The inertial environment: strapdown navigation aided by GNSS."""

from kfenv.envs.pages import with_page
from kfenv.envs.tracking import TrackingEnv, TrackingVectorEnv
from kfenv.scenarios.inertial.ins_gnss import InsGnss


@with_page
class InsGnssEnv(TrackingEnv):
    """An inertial unit aided by GNSS position, velocity and attitude with outliers.

    ## Description
    A vehicle's inertial unit measures specific force and angular rate {scenario.rate:g} times a
    second, with white noise and biases; the filter integrates them (strapdown mechanisation).
    GNSS with several antennas tells position, velocity and attitude
    {scenario.measurement_rate:g} times a second. Faults give its fixes outliers, more noise or
    gaps, tell the filter a wrong noise level, and make the inertial unit itself go wrong. The
    agent turns the knobs of the filter, which must then trust GNSS or the unit more than it does.

    {decisions}; unless told with ``biases``, it does not estimate the unit's biases, its process
    noise stands for them. Its measurements are the fixes.

    The frame is local: north, east, down, flat, gravity 9.81 m/s^2; Earth rotation and
    transport rate are neglected. Body axes are forward, right, down.

    With ``log`` the filter runs on a real log instead: a window of it an episode. Gravity is
    that of the latitude and height, and the state has six biases more. A window begins with the
    estimate, and its covariance, of a filter that ran from where the vehicle first moved,
    aligned there by gravity and the course, up to the window's first fix; nothing is pending at
    the first decision. Without attitude in it, the groups are position and velocity, and there
    is one knob less, and there are eight features less. Fixes are moved along their velocity to
    the nearest decision.

    {info}

    ## Action Space
    {action_space}

    ## Observation Space
    {observation_space}

    ## Rewards
    {rewards}

    With a ``log`` of two files, errors are the distances to the fixes that faults withhold
    from the filter, and nothing else counts; ``position_error`` is the latest of a decision,
    and it and ``nees`` are left out where there is none (NaN in the vector environment).

    ## Starting State
    {random_flight}, in coordinated turns. With ``faults="paper"`` it begins as the paper's,
    270 m/s, a bank of 45 deg, and goes on as ours: the bank swings to the other side and back in
    50 s. {initial_deviations}; the deviations are the paper's.

    {first_decision}

    ## Episode End
    {episode_end}

    ## Arguments
    - ``duration``: of an episode, s. Default {scenario.duration:g}; random flights last at most
      {flight.MAX_DURATION:g}.
    - ``rate``: inertial samples, which are filter steps, per second, {rates}.
    - ``measurement_rate``: fixes per second (default {scenario.measurement_rate:g}), a divisor of
      ``rate``; where it is more than that, a fix falls on every sample.
    - ``gnss_noise``: standard deviations of a fix's position (m), velocity (m/s) and
      attitude (deg), each a number or one for each axis, default {scenario.gnss_noise}, the
      paper's table.
    - ``imu_noise``: white noise of a sample at {module.SAMPLE_RATE:g} Hz, m/s^2 and deg/s,
      default {scenario.imu_noise}; at another rate its density is the same.
    - ``imu_bias``: standard deviations of the biases, m/s^2 and deg/s, drawn per axis and
      episode, default {scenario.imu_bias}; with ``faults="paper"`` the biases themselves.
    - ``imu_instability``: standard deviations of biases that wander with a correlation time
      of {module.INSTABILITY_TIME:g} s, m/s^2 and deg/s, default {scenario.imu_instability}.
    - ``process_noise``: what the filter believes of the errors that the samples bring into
      position (m), velocity (m/s) and attitude (deg): standard deviations after a second,
      default {scenario.process_noise}, the paper's table; of a log {module.UNIT_NOISE}, which
      suits a small unit on a car.
    - ``log``: paths of CSV files to run on, ``(IMU, GNSS)`` or ``(IMU, GNSS, TRUTH)``, one clock,
      columns by name (`kfenv.scenarios.inertial.files`). IMU: ``t`` s, ``fx, fy, fz`` m/s^2,
      ``wx, wy, wz`` rad/s, axes forward, right, down. GNSS: ``t, lat, lon`` deg, ``height`` m,
      ``vn, ve, vd`` m/s and the deviations ``sd_n, sd_e, sd_d, sd_vn, sd_ve, sd_vd``, or RTKLIB's
      ``.pos`` with velocities. TRUTH: the first seven of these. Samples are averaged to ``rate``;
      the fixes set ``measurement_rate``; ``process_noise`` should suit the unit. Episodes are
      windows of the log's first 30 %; contests tune there too, validate on the next 20 % and test
      on the rest. No seed changes their windows: each ends with an outage of {module.OUTAGE:g} s
      (three fifths of ``duration`` at most), and where agents are validated or tested these tile
      the part. With other ``faults`` such windows do not overlap, and agents are tuned on drawn
      ones.
    - ``biases``: whether the state holds the biases of accelerometers and gyroscopes too, 15
      in all. Their process noise has a knob of its own, ``"bias_process_noise"``, on top of that
      of all states. Default: with a ``log`` yes, otherwise no.
    - ``bias_drift``: what the filter believes of them: standard deviations that white noise
      would add in a second, m/s^2 and deg/s, default {scenario.bias_drift}.
    - ``bias_time``: their correlation times, s, default {scenario.bias_time}.
    - ``earth``: whether that filter also takes the Earth's rotation, its curvature and the
      loss of gravity with height into account (default no): for a long ``log``.
    - ``mounting``: roll, pitch and yaw of the ``log``'s unit in the vehicle, deg, which are taken
      out, default {scenario.mounting}. `kfenv inspect` estimates them, and an unlikely log is
      refused with the estimates.
    - ``time_offset``: what is added to the inertial times of the ``log``, s. Default
      {scenario.time_offset:g}; estimated likewise.
    - ``constraints``: what a vehicle on wheels cannot do, measured as nothing beside the fixes
      of a ``log``, in outages too, each a channel group with a knob of its own; default
      {scenario.constraints}. ``"non_holonomic"``: its velocity to the right and along the body's
      down axis is zero. ``"zero_velocity"`` and, with biases, ``"zero_rate"``: it stands, and
      the gyroscopes measure their biases, while the samples are as quiet as where the fixes of
      the log's first 30 % say that it stands.
    - ``constraint_noise``: standard deviations of these, m/s, m/s and deg/s, default
      {scenario.constraint_noise}.
    - ``faults``: what spoils an episode.

      - ``"random"`` (default; with a ``log`` as ``"outages"``): {preset[random]}.
      - ``"outages"``: {preset[outages]}.
      - ``"paper"``: the paper's case, {preset[paper]}.
      - ``"none"``.
      {other_faults}

      A fault of one's own finds the inertial samples in ``draft.motion_inputs``.

    {options}

    ## Version History
    - v0: initial version.
    """

    scenario_class = InsGnss


@with_page
class InsGnssVectorEnv(TrackingVectorEnv):
    """Many `InsGnssEnv` in lock-step over one compiled filter, see there.

    {vector_arguments}
    """

    scenario_class = InsGnss
