"""A particle filter that knows how faults are drawn: a limit, not a contestant."""
