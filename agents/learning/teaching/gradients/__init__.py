"""Gradients through the engine's filter: a compiled sweep from the last step to the first."""
