"""Bistatic tracking: positions measured from reflections of GPS signals (Lazarov et al.)."""

from kfenv.envs.pages import with_page
from kfenv.envs.tracking import TrackingEnv, TrackingVectorEnv
from kfenv.scenarios.radar.bistatic import BistaticTracking


@with_page
class BistaticTrackingEnv(TrackingEnv):
    """A target whose position is measured from the GPS signals that it reflects.

    ## Description
    The position of one target is solved from reflections of GPS signals, {scenario.rate:g} times
    a second: x, y and z with noise of variance {module.VARIANCE[0]:g}, {module.VARIANCE[1]:g} and
    {module.VARIANCE[2]:g} m^2. The target moves as a Wiener process
    in the acceleration of each axis. Faults raise the noise, take measurements away, and
    make the sensor tell the filter a wrong noise level. The agent turns the knobs of the
    filter that tracks.

    {decisions}; its motion model is that of the truth, constant acceleration with a white jerk
    of {module.SPECTRAL_DENSITY:g} m^2/s^5 per axis. Both models are linear, so that with
    nominal knobs it is the Kalman filter.

    {info}

    ## Action Space
    {action_space}

    ## Observation Space
    {observation_space}

    ## Rewards
    {rewards}

    ## Starting State
    The target rests at the origin, and is carried off by the process: after a minute it is
    some 4 km away and flies at 180 m/s. (The filter is linear: its errors do not depend on
    where the target is, nor on how fast.) {initial_deviations}; in the published case it is
    the truth.

    {first_decision}

    ## Episode End
    {episode_end}

    ## Arguments
    - ``duration``: of an episode, s. Default {scenario.duration:g}, or
      {module.PAPER_DURATION:g} with ``faults="paper"``.
    - ``rate``: measurements per second, {rates}.
    - ``faults``: what spoils an episode.

      - ``"random"`` (default): {preset[random]}.
      - ``"paper"``: the published case, 50 measurements without a fault, the initial state
        known.
      - ``"none"``.
      {other_faults}

    - ``plots``: {plots}
    {options}

    ## Version History
    - v0: initial version.
    """

    scenario_class = BistaticTracking


@with_page
class BistaticTrackingVectorEnv(TrackingVectorEnv):
    """Many `BistaticTrackingEnv` in lock-step over one compiled filter, see there.

    {vector_arguments}
    """

    scenario_class = BistaticTracking
