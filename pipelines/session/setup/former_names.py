"""Former names of commands and inputs, taken for one release with a line."""

import sys

COMMANDS = {"owner": "authority"}
#: Who drives, as `kontur-av authority` takes it.
DRIVERS = {"iss": "operator"}
INPUTS = {"iss_camera": "operator_camera", "iss_mic": "operator_mic"}


def current(name: str, names: dict[str, str]) -> str:
    """Return the present name for a former one, and say so on standard error."""
    if name not in names:
        return name
    print(f"kontur-av: {name} is called {names[name]} now", file=sys.stderr)
    return names[name]
