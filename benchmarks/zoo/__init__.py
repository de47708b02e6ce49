"""A zoo of simulated logs with known truth, which go through the default path from the files to the estimate."""
