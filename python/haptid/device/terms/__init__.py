"""Terms of the model in addition to link inertia: friction, springs, custom columns."""
