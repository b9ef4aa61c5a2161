"""Supervision: how the two ends of the link find, check and lose each other."""
