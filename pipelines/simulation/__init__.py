"""A session on virtual time: the cores of the live one, driven by a simulated clock."""
