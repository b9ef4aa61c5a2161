"""What is joined to what: setups, processes, the launcher, the report and the command."""
