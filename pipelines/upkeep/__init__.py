"""Upkeep of both ends: versions, storages and maintenance."""
