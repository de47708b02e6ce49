"""Numbers with uncertainty, and tests of several of them."""
