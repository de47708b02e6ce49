"""The proposed treatment of a log, and the delay of its torque."""
