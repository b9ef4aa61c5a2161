"""The robot's ports for a partner whose joystick is across the Internet."""

import asyncio
import socket

from kontur_av.errors import ConfigError
from pipelines.partner.samples import SamplePeer
from pipelines.session.datagrams import listen, newest_sample, outlet
from pipelines.session.process import LOOPBACK, Context
from pipelines.session.topology import partner_ports


class SamplePorts:
    """Between one partner's data channel and the robot's ports of `docs/rtc.md`.

    The port of the robot's samples is taken while a partner is there, so a joystick on this machine
    can have it otherwise.
    """

    def __init__(self, context: Context, loop: asyncio.AbstractEventLoop) -> None:
        taken, self._given = partner_ports(context.setup)
        self._loop = loop
        self._to_robot = outlet(LOOPBACK, (LOOPBACK, taken))
        self._from_robot: socket.socket | None = None

    def join(self, peer: SamplePeer) -> None:
        """The robot's samples go to this partner. ConfigError if a joystick here has them."""
        self.leave()
        try:
            udp = listen((LOOPBACK, self._given))
        except OSError:
            raise ConfigError("another joystick drives already") from None
        self._from_robot = udp

        def forward() -> None:
            newest = newest_sample(udp)
            if newest is not None:
                peer.send(newest)

        self._loop.add_reader(udp, forward)

    def leave(self) -> None:
        """The partner is gone."""
        udp, self._from_robot = self._from_robot, None
        if udp is not None:
            self._loop.remove_reader(udp)
            udp.close()

    def handle(self, sample: bytes) -> None:
        """A sample of the partner has come."""
        self._to_robot.send(sample)
