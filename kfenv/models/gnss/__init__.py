"""Satellite navigation: orbits, signal delays, receiver clock and pseudoranges (SPEC 3.4, 4.3)."""
