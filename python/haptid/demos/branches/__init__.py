"""Branches of one device: identification, essential parameters, what the hand feels, and less of it."""
