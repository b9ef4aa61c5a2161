"""Haptics: the 12-octet sample, joystick, robot, and their controllers at 1 kHz."""
