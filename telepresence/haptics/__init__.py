"""The hand: the 12-octet haptic sample, the joystick, the robot and their 1 kHz loops."""
