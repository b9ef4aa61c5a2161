"""Upkeep: versions of the communication software, and the joystick computer's AppLoader."""
