"""The built-in setups, as data."""
