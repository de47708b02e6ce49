"""What an estimate says: targets, comparisons, drift, drive gains, payloads and diagnosis."""
