"""Radar and bistatic scenarios: what the radar sees, and what jams it.

May import models and the modules beside the rooms.
"""
