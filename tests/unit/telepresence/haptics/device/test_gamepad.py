"""A game controller of the kernel: found, opened, and read through the library's own reader."""

import os
import struct
from types import SimpleNamespace

import pytest
from gamepads import AXES, CONTROLLERS, KEYS, settled

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError
from telepresence.haptics.axes import check_axes
from telepresence.haptics.device.gamepad import GamepadDevice, feed, find_gamepads, open_gamepad
from telepresence.haptics.device.stick import Stick
from telepresence.haptics.specs import check_joystick


class Kernel:
    """An `evdev.InputDevice` of a pad."""

    name = "a pad"

    def __init__(self):
        axes = {
            code: SimpleNamespace(value=axis.value, min=axis.least, max=axis.most, flat=axis.flat)
            for code, axis in CONTROLLERS["pad"][0].items()
        }
        self.capabilities = lambda absinfo: {1: list(KEYS), 3: list(axes.items())}
        self.absinfo = axes.get
        self.read, self.active_keys = list, lambda: [0x136]


def test_the_device_reads_its_further_axes_from_the_kernel():
    kernel = Kernel()
    device = GamepadDevice(kernel, ("z", "gripper"))
    kernel.read = lambda: [SimpleNamespace(type=3, code=4, value=-32768)]
    device.read()
    for _ in range(500):
        device.write_more_forces([3.0, 1.0])
        device.advance(NS_PER_MS)
    z, gripper = device.read_more()
    assert z.position == pytest.approx(0.1, abs=1e-4) and gripper.position == 0.0
    check_axes("joystick evdev", device.capabilities.more, ("z", "gripper"))


def test_a_missing_controller_is_refused_in_one_line(tmp_path):
    pytest.importorskip("evdev")
    assert find_gamepads(tmp_path) == []
    with pytest.raises(ConfigError, match="no game controller here: plug one in"):
        open_gamepad(folder=tmp_path)
    (tmp_path / "event3").write_bytes(b"")
    assert "cannot be opened" in find_gamepads(tmp_path)[0].problem
    with pytest.raises(ConfigError, match=r"event3 is no input device .*joystick list"):
        open_gamepad(str(tmp_path / "event3"))
    with pytest.raises(ConfigError, match="is no input device"):
        check_joystick("evdev:/dev/null")


def test_the_library_reads_the_kernels_octets():
    evdev = pytest.importorskip("evdev")
    read_end, write_end = os.pipe2(os.O_NONBLOCK)

    class Events(evdev.eventio.EventIO):
        """The library's reader on a pipe instead of a device file."""

        fd = read_end

    # struct input_event: a struct timeval, type, code, value.
    event = struct.Struct("@llHHi")
    os.write(
        write_end,
        event.pack(1, 2, 3, 0, 255)
        + event.pack(1, 2, 1, 0x131, 1)
        + event.pack(1, 2, 0, 0, 0)
        + event.pack(1, 3, 1, 0x136, 1),
    )
    stick = Stick("pad", AXES, KEYS)
    feed(stick, Events())
    reading = settled(stick)
    assert (reading.buttons, reading.dead_man, reading.present) == (0b10, True, True)
    assert reading.x_m > 0.09
    feed(stick, Events())  # nothing new, and no matter
    assert stick.present
    os.close(read_end)
    feed(stick, Events())
    assert not stick.present
    os.close(write_end)
