"""Whose fault is it? Each error class answers for one party."""


class ConfigError(Exception):
    """The user's mistake: one line that names the mend. The command exits with code 2."""


class ProtocolError(Exception):
    """The peer's garbage: counted and dropped by its receiver, never a crash."""
