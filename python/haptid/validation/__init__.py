"""How well an estimate predicts torque it has not been fitted to."""
