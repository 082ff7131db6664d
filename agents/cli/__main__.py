"""`python -m kfenv.agents.cli`, the same as `kfenv`."""

from .app import app

app()
