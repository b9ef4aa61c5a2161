"""Telecommands and telemetry, tasks, panel, LEDs and trainer."""
