"""Learning from an agent that knows more, then by gradients through the filter itself."""
