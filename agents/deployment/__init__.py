"""Out again: a tuned filter for live measurements, and policies for other systems.

May import the contestants and the contest; only the command line imports it.
"""

from .tuned_filter import Step, TunedFilter

__all__ = ["Step", "TunedFilter"]
