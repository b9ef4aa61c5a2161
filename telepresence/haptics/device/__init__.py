"""The joystick as a device: its states, its supervision, its calibration, its functional checks.

`operation.Operation` runs a `device.JoystickDevice`: simulated (`simulated`) or a game controller
(`gamepad`). `checks` holds the functional checks. Only `gamepad` accesses the system.
"""
