"""Upkeep: directories of versions and copies with the programs in them, and maintenance."""
