"""How a motion becomes rows of the observation matrix."""
