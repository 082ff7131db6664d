"""Who competes: fixed and rule-based agents, filters of the family, and learned policies.

May import kfenv and `agents.files`, but no other room.
"""
