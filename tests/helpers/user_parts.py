"""The samples' own robot and joystick, as modules, and axes to give them."""

import importlib.util
from dataclasses import replace

from positions import ROOT

from telepresence.haptics.axes import AxisCapabilities, AxisReading, SimulatedAxis

MORE = (
    AxisCapabilities(name="z", half_range=0.1, force_limit=10.0, speed=0.5),
    AxisCapabilities(name="yaw", half_range=1.0, force_limit=0.5, speed=3.0),
)


def load(name):
    """Return the sample in a file of this name as a module."""
    spec = importlib.util.spec_from_file_location(name.removesuffix(".py"), ROOT / "samples" / name)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Guided:
    """Mixed in before a device: z and yaw, each a mass on a guide."""

    def __init__(self):
        super().__init__()
        self.capabilities = replace(self.capabilities, more=MORE)
        self.axes = [SimulatedAxis(capabilities, meets=False) for capabilities in MORE]

    def read_more(self):
        return [
            AxisReading(axis.position_m / axis.lever_m, axis.speed_m_s / axis.lever_m)
            for axis in self.axes
        ]

    def write_more_forces(self, forces):
        for axis, force in zip(self.axes, forces, strict=True):
            axis.force_n = force / axis.lever_m

    def advance_axes(self, dt_ns):
        for axis in self.axes:
            axis.step(axis.cut_n, dt_ns)

    def release_axes(self):
        for axis in self.axes:
            axis.force_n = 0.0
