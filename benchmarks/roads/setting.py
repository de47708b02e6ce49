"""The log, and the treatment that every road gives it."""

JOINTS = 7
RATE_HZ, CUTOFF_HZ, DECIMATION = 1000.0, 40.0, 10
