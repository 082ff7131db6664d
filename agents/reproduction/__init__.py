"""The papers' experiments, run anew: figures, and a verdict on each claim by its numbers.

May import kfenv's scenarios, filters and models, and the shared modules beside the rooms; no
other room, since nothing here learns or decides.
"""
