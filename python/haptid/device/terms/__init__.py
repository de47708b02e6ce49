"""Terms beyond link inertia: friction, springs, rotors and custom columns, each one column of the regressor."""
