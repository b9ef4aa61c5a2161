"""Error classes, one for each party that can be at fault."""


class ConfigError(Exception):
    """The user's mistake. Its message is one line that names the mend; commands exit with 2."""


class ProtocolError(Exception):
    """Garbage from the peer. Its receiver counts and drops it, and goes on."""
