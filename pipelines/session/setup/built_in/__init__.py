"""The built-in setups, as data."""

from pipelines.session.setup.built_in.spacejustin import SPACEJUSTIN
from pipelines.session.setup.built_in.taskboard import TASKBOARD

BUILT_IN = {setup.name: setup for setup in (SPACEJUSTIN, TASKBOARD)}
