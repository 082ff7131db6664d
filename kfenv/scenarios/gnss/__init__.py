"""Satellite navigation: simulated receivers and their faults, RINEX logs, least-squares fixes.

May import models and the modules beside the rooms.
"""
