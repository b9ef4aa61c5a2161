"""Space packets for another ground system: telemetry out, telecommands in."""
