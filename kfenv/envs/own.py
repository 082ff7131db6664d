"""A filter of one's own: any motion, any sensor, and the states that count."""

from kfenv.envs.pages import with_page
from kfenv.envs.tracking import TrackingEnv, TrackingVectorEnv
from kfenv.scenarios.own import OwnFilter


@with_page
class FilterEnv(TrackingEnv):
    """Your own filter: any motion and sensor, simulated or on your own recording.

    ## Description
    Your models inside the filter whose knobs an agent turns, in a world that moves as the models
    do, or on a recording that you have. `kfenv.models.own` makes a motion of a function f, names
    of the states and Q, and a sensor of a function h and names of the channels. Without models it
    is an example: a robot with two driven wheels (`kfenv.models.robot`) that sees the distance
    and the bearing of two beacons {scenario.rate:g} times a second. Faults raise the noise, take
    measurements away, and make the sensor tell the filter a wrong noise level.

    {decisions}.

    Functions that are written with the namespace, ``f(xp)`` and ``h(xp)``, run in the compiled
    engine, at the speed of the other environments, and serve every agent and every kind of
    training. Plain NumPy functions, ``f(x, u, dt)`` and ``h(x, s)``, are called for all sigma
    points of all filters at once, between compiled steps that serve every model: nothing is
    compiled for them, and a batch is several times slower than the engine (`kfenv bench` tells
    how much); banks of filters, ``okf``, ``kfenv limit`` and training through the filter, which
    need the engine, refuse them.

    {info}

    ## Action Space
    {action_space}

    ## Observation Space
    {observation_space}

    ## Rewards
    {rewards}

    ## Starting State
    {initial_deviations}. The estimate begins at ``mean``, and the truth is drawn with the
    covariance ``P`` about it. (Figures, units, knobs and features here are the example's.)

    {first_decision}

    ## Episode End
    {episode_end}

    ## Arguments
    - ``motion``: a `kfenv.models.model.Motion`, or ``"module:name"`` of one (or of a function that
      makes it), as the command line gives it.
    - ``sensor``: a `kfenv.models.model.Sensor`, likewise.
    - ``scored``: names of the states whose error counts (default {scenario.scored}, the
      example's), or a sensor without inputs whose channels are what counts. The error is the root
      of their summed squared errors, angles wrapped.
    - ``scale``: the error that is just good enough, in their unit (default {scenario.scale:g});
      where units differ one number for each, and the error is then told in scales.
    - ``scored_rates``: names of the states that are the rates of those scored, for features that
      are left out without (default {scenario.scored_rates}).
    - ``lost``: an error of more scales is a loss (default {scenario.lost:g}).
    - ``R``: (m, m) covariance of the measurements' noise, diagonal, or (m,) variances (default
      {scenario.R}).
    - ``mean``: (n,) of the state at the beginning (default {scenario.mean}).
    - ``P``: (n, n) its covariance, or (n,) variances (default {scenario.P}).
    - ``inputs``: what the motion is told at each instant, (T, p): an array, or a function of a
      NumPy generator and the times that draws one for each episode. The truth is driven by it, and
      what noise it has is part of Q.
    - ``sensor_inputs``: what the sensor is told, (T, k), likewise; ``"inputs"`` for the same as
      the motion.
    - ``measure_every``: filter steps from one measurement to the next (default
      {scenario.measure_every}).
    - ``duration``: of an episode, s (default {scenario.duration:g}).
    - ``rate``: filter steps per second, any (default {scenario.rate:g}).
    - ``faults``: what spoils an episode.

      - ``"random"`` (default; times are shares of the duration): {preset[random]}.
      - ``"none"``.
      {other_faults}

    {options}

    ``R``, ``mean``, ``P``, ``inputs`` and ``faults`` are for simulation, and a ``recording``
    brings its own. `kfenv.scenarios.own.recording_of` makes one of arrays. Contests keep its
    first 40 % of episodes for tuning (and training draws from these), the next 20 % for
    validation and the rest for the test.

    ## Version History
    - v0: initial version.
    """

    scenario_class = OwnFilter


@with_page
class FilterVectorEnv(TrackingVectorEnv):
    """Many `FilterEnv` in lock-step over one filter, see there.

    {vector_arguments}
    """

    scenario_class = OwnFilter
