"""The log, and the treatment of every pipeline."""

JOINTS = 7
RATE_HZ, CUTOFF_HZ, DECIMATION = 1000.0, 40.0, 10
