"""Satellite orbits, receiver clock, atmosphere and pseudoranges. Imports no other layer."""
