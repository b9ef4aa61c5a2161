"""A session on virtual time: the cores of the live session, driven by a simulated clock."""
