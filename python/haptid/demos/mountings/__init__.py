"""One device in several mountings: fits, judgements, the hand's force, comparisons."""
