"""The built-in setups, as data."""

from pipelines.setup.built_in.spacejustin import SPACEJUSTIN
from pipelines.setup.built_in.taskboard import TASKBOARD

BUILT_IN = {setup.name: setup for setup in (SPACEJUSTIN, TASKBOARD)}
