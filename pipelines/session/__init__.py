"""The floor that the other rooms stand on: setup, table, launcher, process context, probe."""
