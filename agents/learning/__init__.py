"""How agents learn: settings, training by stable-baselines3, checkpoints.

The only room that imports a learning library. May import `contest` and `contestants`.
"""
