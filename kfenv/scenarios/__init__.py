"""What happens: truth, faults and noise, drawn before any filter runs, as a Recording.

Beside the rooms stands what they share (recording, scenario, faults, trajectories, tracks,
reports, smoothing, coverage, columns), which imports none of them. May import models, and
nothing of filters.
"""
