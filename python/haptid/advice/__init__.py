"""Advice: changes of a study, each tested on the same data before it is proposed."""
