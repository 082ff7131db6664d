"""Sigma-point, extended and adaptive filters: a reference tier to read and a compiled engine.

May import models, and nothing of scenarios or environments.
"""
