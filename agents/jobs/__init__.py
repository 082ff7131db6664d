"""Who does independent jobs: processes of this machine, or those of a Ray cluster.

May import the shared modules beside the rooms.
"""
