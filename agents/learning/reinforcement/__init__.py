"""Learning from rewards, by stable-baselines3."""
