"""What an agent's filter says of one whole log or episode, as files: for use, not for scores.

May import `contestants` and `contest`, and the shared modules beside the rooms.
"""
