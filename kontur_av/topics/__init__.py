"""Shared memory: publish once, for any number of readers."""
