"""How agents learn: from rewards or from a teacher; settings and what all runs share.

The only room that imports a learning library. May import `contest` and `contestants`.
"""
