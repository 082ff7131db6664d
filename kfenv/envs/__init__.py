"""The Gymnasium environments: decision process, knobs, observations, rewards, pages, pictures.

May import scenarios, filters and models.
"""
