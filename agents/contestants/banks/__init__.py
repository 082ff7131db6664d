"""Banks of filters as contestants: several compiled filters an episode, mixed (SPEC section 10)."""
