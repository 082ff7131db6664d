"""The satellite navigation environment."""

from kfenv.envs.pages import with_page
from kfenv.envs.tracking import TrackingEnv, TrackingVectorEnv
from kfenv.scenarios.gnss.tracking import GnssTracking


@with_page
class GnssTrackingEnv(TrackingEnv):
    """An aircraft located by satellites while its receiver is jammed, spoofed and loses lock.

    ## Description
    A receiver on an aircraft measures pseudoranges and their rates to the satellites above
    {scenario.mask:g} deg, up to {module.CHANNELS}, at {scenario.measurement_rate:g} Hz; the filter
    runs at {scenario.rate:g} steps a second. Their noise is 3 m and
    {module.RATE_NOISE:g} m/s: code noise, multipath by elevation and what the corrections leave
    of the troposphere. Faults make the receiver's clock jitter, take all satellites away,
    draw single satellites aside, raise the noise, and make the receiver tell the filter a
    wrong noise level. The agent turns the knobs of the filter that tracks.

    {decisions}; its motion model is the variable turn with a white jerk of 1 m^2/s^5 per axis,
    beside a clock whose drift is driven by white noise of {module.CLOCK_DENSITY:g} (m/s)^2/s.

    A channel follows one satellite for as long as it is visible, so that others rise and
    set without disturbing it; free channels go to the highest satellite without one.
    The whole troposphere, dry and wet, delays the signals. Satellite clocks and the standard
    troposphere and ionosphere are taken off the pseudoranges; the wet delay's random walk
    stays (1 cm in an hour).

    {info}

    The axes are those of the earth-fixed WGS84 frame.

    ## Action Space
    {action_space}

    A knob of the table serves all satellites; to leave out a single one, one whose range is
    stepped or drawn away, takes those of its channels.

    ## Observation Space
    {observation_space}

    ## Rewards
    {rewards}

    ## Starting State
    {random_flight} above ``place`` and within {flight.MAX_RANGE:g} m of it; our trajectory B
    with ``faults="paper"``; or a window of ``track``. The time of day is random too,
    unless ``date`` tells it. {initial_deviations}.

    {first_decision}

    ## Episode End
    {episode_end}

    ## Arguments
    - ``duration``: of an episode, s. Default {scenario.duration:g}, or
      {module.PAPER_DURATION:g} with ``faults="paper"`` and {module.LOG_DURATION:g} with
      ``rinex``; random flights last at most {flight.MAX_DURATION:g}.
    - ``rate``: filter steps per second, {rates}.
    - ``measurement_rate``: measurements per second (default {scenario.measurement_rate:g});
      must divide ``rate``.
    - ``faults``: what spoils an episode.

      - ``"random"`` (default), each starting at random: {preset[random]}.
      - ``"paper"``: the paper's case, whose flight, hour and faults are ours. Trajectory B at
        five in the morning (six satellites in view), a clock that jitters, unknown to the
        filter, and then no satellite: {preset[paper]}.
      - ``"none"``.
      {other_faults}

      The true noise that the clairvoyant agent knows is each channel's own. It does not
      know of a clock's jitter, which is common to all satellites; of steps and ramps knows
      ``clairvoyant-channels``, which turns the channels' knobs.
    - ``place``: latitude and longitude (deg) and height (m) of the flights' origin
      (default {scenario.place}).
    - ``date``: a day such as ``"{scenario.date}"`` (default), at a random time of which each
      episode begins, or the instant at which all begin, such as ``"2016-02-29T05:00"``;
      GPS time.
    - ``almanac``: path of a YUMA almanac file, whose healthy satellites are used at
      ``date``; by default the published baseline constellation of 24 slots.
    - ``mask``: elevation above which satellites are used, deg (default {scenario.mask:g}).
    - ``ionosphere``: share of Klobuchar's ionospheric delay that the corrections leave, -1
      to 1 (default {scenario.ionosphere:g}; 0.5 is usual). The filter is not told.
    - ``troposphere``: share of the standard tropospheric delay that they leave, -1 to 1
      (default {scenario.troposphere:g}). The filter is not told.
    - ``track``: {track_file}: a random window of it, where it was flown.
    - ``cutoff``: period of motion that smoothing the flight halves, s (default 25, or less
      where the aircraft turns too fast for that).
    - ``longest_gap``: between two of its reports that an episode may bridge, s (default
      {scenario.longest_gap:g}; in cruise reports may lie a minute apart).
    - ``rinex``: paths of a RINEX 2 or 3 observation file and its navigation file, in place of
      all that is simulated: GPS on L1, and where the files have them Galileo on E1, BeiDou on
      B1I and QZSS. Pseudoranges are cleared of satellite clocks, group delay, relativity,
      troposphere, Klobuchar's ionosphere and the biases between the systems (one number each,
      estimated on the log); rates are the Doppler's, where there is any. The told noise is the
      error budget, with half of the ionosphere's delay added; where the file tells C/N0, noise of
      code and Doppler goes by it, as measured on the log's first 30 %. Filter steps are at most
      1 s long, from epoch to epoch. A receiver that stood still has the header's position as
      its truth; the motion model is constant acceleration, since it has no turn rate, and is not
      told that the receiver rests: to tune for one that moves, expose the noise knobs alone. Of
      one that moved the third path is the truth: a CSV file with lat, lon (degrees), height (m)
      and t (GPS seconds since 1980, of the week, or since the log began) or week and seconds, or
      RTKLIB's .pos. Episodes are windows of ``duration`` ({module.LOG_DURATION:g} by default)
      from the first 30 % of the log's time; ``kfenv evaluate --rinex`` tests on windows of its
      last half, ``kfenv train`` validates between the two. Each window starts with the
      least-squares fix of its first epoch, whose measurement is then spent. ``rate`` is the log's,
      and of the other arguments only ``duration`` and the next two go with it.
    - ``moving``: True for the log, or ``recording``, of a vehicle. Without a truth the filter
      misses the last of every six stretches of 10 s (of a sixth of a shorter window, or of an
      epoch where those are rarer), and
      its error is counted there, against the fixes; these jitter by metres themselves.
    - ``manoeuvre``: of a vehicle, deviation (m/s^2) and time constant (s) of its acceleration, a
      first-order Markov process (default {scenario.manoeuvre}).
    {options}

    A ``recording`` has the channels and inputs of
    `kfenv.models.gnss.pseudorange.pseudoranges`. With ``rinex`` a decision by default concerns
    one epoch, but for the first, whose measurement is spent; the same ``rinex`` beside a
    recording of its windows tells how far they lie apart. Pictures are drawn east, north and up
    about the first estimate.

    ## Version History
    - v0: initial version.
    """

    scenario_class = GnssTracking


@with_page
class GnssTrackingVectorEnv(TrackingVectorEnv):
    """Many `GnssTrackingEnv` in lock-step over one compiled filter, see there.

    {vector_arguments}
    """

    scenario_class = GnssTracking
