"""The subcommands of kontur-av, one module each."""
