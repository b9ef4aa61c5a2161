"""Telecommands and telemetry after PUS, and the experiment's messages (K2ACI)."""
