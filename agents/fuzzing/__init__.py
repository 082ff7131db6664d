"""Tries filters, environments and readers with what nobody thought of; `kfenv fuzz`.

Cases are drawn from NumPy's generators, not by Hypothesis: the command needs nothing that only
tests need, a case costs one batch of arrays and no example at a time, and three numbers repeat it.
"""
