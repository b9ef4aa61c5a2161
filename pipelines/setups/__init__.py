"""The built-in setups, as data."""

from pipelines.setups.spacejustin import SPACEJUSTIN
from pipelines.setups.taskboard import TASKBOARD

BUILT_IN = {setup.name: setup for setup in (SPACEJUSTIN, TASKBOARD)}
