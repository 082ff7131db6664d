"""The radar environments."""
from kfenv.envs.tracking import TrackingEnv, TrackingVectorEnv
from kfenv.scenarios.radar_tracking import RadarTracking
from kfenv.scenarios.radar_validation import RadarValidation


class RadarTrackingEnv(TrackingEnv):
    scenario_class = RadarTracking


class RadarTrackingVectorEnv(TrackingVectorEnv):
    scenario_class = RadarTracking


class RadarValidationEnv(TrackingEnv):
    scenario_class = RadarValidation


class RadarValidationVectorEnv(TrackingVectorEnv):
    scenario_class = RadarValidation
