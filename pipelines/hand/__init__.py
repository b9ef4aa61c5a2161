"""The 1 kHz loops of robot and joystick, and who owns the arm."""
