"""Upkeep on this machine: directories of versions and copies, and the programs in them."""
