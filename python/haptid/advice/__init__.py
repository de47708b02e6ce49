"""What to change in a study: proposals that are tried on the same data before they are made."""
