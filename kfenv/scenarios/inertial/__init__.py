"""Inertial navigation aided by fixes: simulated units and their faults, and real logs.

May import models and the modules beside the rooms.
"""
