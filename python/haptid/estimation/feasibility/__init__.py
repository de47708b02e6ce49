"""Physical consistency: the cone of standard parameters that rigid bodies can have."""
