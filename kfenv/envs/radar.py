"""The radar environments: tracking under faults, and the papers' validation case."""

from kfenv.envs.pages import with_page
from kfenv.envs.tracking import TrackingEnv, TrackingVectorEnv
from kfenv.scenarios.radar.tracking import RadarTracking
from kfenv.scenarios.radar.validation import RadarValidation


@with_page
class RadarTrackingEnv(TrackingEnv):
    """A manoeuvring aircraft before a phased-array radar that is jammed and misreports.

    ## Description
    A radar at the origin measures range, azimuth (clockwise from north) and elevation of
    one aircraft within {flight.MAX_RANGE:g} m, {scenario.rate:g} times a second. Its noise
    follows from the radar equation: 0.04 m and 0.05 deg at 10 km on broadside, more with
    distance, scan angle and rain. Faults raise the noise, take measurements away, and make
    the radar tell the filter a wrong noise level. The agent turns the knobs of the filter
    that tracks.

    {decisions}; its motion model is the variable turn with a white jerk of 1 m^2/s^5 per axis.

    {info}

    The axes are x east, y north and z up.

    ## Action Space
    {action_space}

    ## Observation Space
    {observation_space}

    ## Rewards
    {rewards}

    ## Starting State
    {random_flight} and within coverage (1.5 to 17 km, 55 deg off a broadside 20 deg above
    north); trajectory B with ``faults="paper"``; or a window of ``track``.
    {initial_deviations}.

    {first_decision}

    ## Episode End
    {episode_end}

    ## Arguments
    - ``duration``: of an episode, s. Default {scenario.duration:g}, or
      {module.PAPER_DURATION:g} with ``faults="paper"``; random flights last at most
      {flight.MAX_DURATION:g}.
    - ``rate``: measurements per second, {rates}; 2 is the harder contest.
    - ``faults``: what spoils an episode.

      - ``"random"`` (default): {preset[random]}.
      - ``"paper"``: the paper's case, whose flight, gap and times are ours. Trajectory B, a
        jammer carried by the target, of whose noise the filter is told, and a gap:
        {preset[paper]}.
      - ``"none"``.
      {other_faults}

    - ``flights``: how random flights are flown, ``"manoeuvring"`` (default), ``"gentle"`` (in
      between) or ``"smooth"``:
      {smooth_flight}.
    - ``track``: {track_file}: by default a random window of it, placed at random before the
      radar.
    - ``radar_position``: {radar_position}
    - ``plots``: {plots}
    - ``cutoff``: period of motion that smoothing the flight halves, s (default 25, or less
      where the aircraft turns too fast for that).
    - ``longest_gap``: between two of its reports that an episode may bridge, s (default
      {scenario.longest_gap:g}; in cruise reports may lie a minute apart).
    - ``altitude_offset``: added to its height, m: negative for a flight that is too high for
      the radar (default {scenario.altitude_offset:g}).
    {options}

    ## Version History
    - v0: initial version.
    """

    scenario_class = RadarTracking


@with_page
class RadarTrackingVectorEnv(TrackingVectorEnv):
    """Many `RadarTrackingEnv` in lock-step over one compiled filter, see there.

    {vector_arguments}
    """

    scenario_class = RadarTracking


@with_page
class RadarValidationEnv(TrackingEnv):
    """The papers' validation case: constant acceleration, fixed radar noise.

    ## Description
    A radar at the origin measures range, azimuth (clockwise from north) and elevation of
    one aircraft with noise of constant deviation: 20 m, 1.45 deg, 1.45 deg at ten
    measurements a second, or 30 m, 1.45 deg, 5 deg at two. The agent turns the knobs of
    the filter that tracks.

    {decisions}; its motion model is constant acceleration with a white jerk of 1 m^2/s^5 per
    axis.

    {info}

    The axes are x east, y north and z up.

    ## Action Space
    {action_space}

    ## Observation Space
    {observation_space}

    ## Rewards
    {rewards}

    ## Starting State
    The flight is trajectory A, ours since no paper gives its own ({flight.PAPER_SPEED[A]:g} m/s,
    closest approach 922 m at 75 s; after {scenario.duration:g} s it flies straight on), or a
    window of ``track``. {initial_deviations}.

    {first_decision}

    ## Episode End
    {episode_end}

    ## Arguments
    - ``duration``: of an episode, s (default {scenario.duration:g}).
    - ``rate``: measurements per second, {rates}. Other rates than 10 and 2 need
      ``noise_deviation``.
    - ``noise_deviation``: standard deviations of range (m), azimuth and elevation (degrees);
      by default the published ones of the rate.
    - ``faults``: what spoils an episode.

      - ``"none"`` (default) and ``"paper"``: nothing, as in the papers.
      - ``"random"``: {preset[random]}.
      {other_faults}

    - ``track``: {track_file}: by default a random window of it, placed at random before the
      radar.
    - ``radar_position``: {radar_position}
    - ``plots``: {plots}
    - ``cutoff``: period of motion that smoothing the flight halves, s (default 25, or less
      where the aircraft turns too fast for that).
    - ``longest_gap``: between two of its reports that an episode may bridge, s (default
      {scenario.longest_gap:g}; in cruise reports may lie a minute apart).
    - ``altitude_offset``: added to its height, m: negative for a flight that is too high for
      the radar (default {scenario.altitude_offset:g}).
    {options}

    ## Version History
    - v0: initial version.
    """

    scenario_class = RadarValidation


@with_page
class RadarValidationVectorEnv(TrackingVectorEnv):
    """Many `RadarValidationEnv` in lock-step over one compiled filter, see there.

    {vector_arguments}
    """

    scenario_class = RadarValidation
