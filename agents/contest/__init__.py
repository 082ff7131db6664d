"""How contestants are compared: roll-outs, tuning, evaluation, figures.

May import `contestants`, and the shared modules beside the rooms.
"""
