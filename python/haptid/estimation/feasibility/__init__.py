"""Physical consistency: the cone of standard parameters of rigid bodies, and projections on it."""
