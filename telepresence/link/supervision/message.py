"""What the ends of the link tell each other: a configuration to share, and messages of supervision.

A message has twelve octets; docs/wire-formats.md has them, and says which first header pointer
marks it. All numbers are big-endian; the layout is this project's own. A message CLOCK
(`telepresence.link.clock_exchange`) has another layout. Only a master sends CONFIGURE, only a slave
CONFIRM.
"""

import struct
from binascii import crc_hqx
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.link.flows import Flow
from telepresence.link.profile import LinkProfile, Repair
from telepresence.link.repair.reserve import Loss

#: Version of the link's format and of its supervision.
VERSION = 4

_LARGEST_RATE_KBPS = 0xFFFF


@dataclass(frozen=True, kw_only=True)
class Configuration:
    """One end's view of the link; at the peer, `transmit` and `receive` are exchanged."""

    transmit: LinkProfile
    transmit_flows: Sequence[Flow]
    receive: LinkProfile
    receive_flows: Sequence[Flow]
    version: int = VERSION

    def __post_init__(self) -> None:
        if not 1 <= self.version <= 15:
            raise ConfigError(f"version is {self.version}: it must be from 1 to 15")

    @property
    def repair(self) -> Repair:
        """What both directions have of repair; `off` only if neither has any."""
        modes = {self.transmit.repair, self.receive.repair} - {"off"}
        return "off" if not modes else "auto" if modes == {"auto"} else "idle"

    def text(self, *, master: bool, repair: bool = True) -> str:
        """Return the text to digest: a line for each profile and flow, master's way out first.

        repair: False: as where neither profile has any.
        """
        ways = [(self.transmit, self.transmit_flows), (self.receive, self.receive_flows)]
        lines = []
        for profile, flows in ways if master else reversed(ways):
            lines.append(
                f"{profile.frame_octets} {profile.insert_octets} {profile.slot_ns} {profile.scid} "
                f"{profile.vcid} {int(profile.pointer_in_vcid)}"
                f"{' repair' if repair and profile.repair != 'off' else ''}\n"
            )
            lines += [
                f"{flow.name} {int(flow.level)} {flow.kind.value} {flow.clock_hz} "
                f"{flow.stride_ticks}\n"
                for flow in flows
            ]
        return "".join(lines)

    def digest(self, *, master: bool, repair: bool = True) -> int:
        """Return the CRC-16 of the text, as of the FECF: equal with equal configurations."""
        return crc_hqx(self.text(master=master, repair=repair).encode(), 0xFFFF)

    def rates_kbps(self) -> tuple[int, int]:
        """Return the rates of whole frames, way out and way in, at most 65535 each."""
        out, in_ = (
            min(profile.capacity_bps // 1000, _LARGEST_RATE_KBPS)
            for profile in (self.transmit, self.receive)
        )
        return out, in_


@dataclass(frozen=True, kw_only=True)
class SupervisionTiming:
    """The waits of supervision, in nanoseconds.

    loss_ns: without a good frame for this long the signal is lost. It is noticed within that time.
    round_trip_ns: the longest round trip of the link; handshakes may take four of them.
    fast_ns: interval of messages while something is unsettled.
    search_ns: interval of messages if nothing changes and the peer may not hear them. They take
        capacity from the media in the only direction that may work.
    slow_ns: interval of messages if all is settled.
    spacing_ns: shortest interval of messages, whatever changes.
    settle_ns: after a change messages stay fast for this long, unless the peer confirms it.
    silence_ns: with frames but no message for this long, the peer's supervision is dead.
    idle_ns: without application data either way for this long, the application link is reset.
    """

    loss_ns: int = 50 * NS_PER_MS
    round_trip_ns: int = NS_PER_S
    fast_ns: int = 20 * NS_PER_MS
    search_ns: int = 50 * NS_PER_MS
    slow_ns: int = 500 * NS_PER_MS
    spacing_ns: int = 10 * NS_PER_MS
    settle_ns: int = 2 * NS_PER_S
    silence_ns: int = 5 * NS_PER_S
    idle_ns: int = 2 * NS_PER_S

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value <= 0:
                raise ConfigError(f"supervision {name} is {value}: it must be positive")
        if not self.spacing_ns <= self.fast_ns <= self.search_ns <= self.slow_ns:
            raise ConfigError(
                "supervision: spacing_ns, fast_ns, search_ns and slow_ns must rise in this order"
            )

    @property
    def answer_ns(self) -> int:
        """How long a master waits for the slave to confirm its configuration."""
        return 4 * self.round_trip_ns


MESSAGE_OCTETS = 12
#: Bits of a fresh number.
NUMBER_BITS = 24

_LAYOUT = struct.Struct(">BBHHH4s")
_HELLO = struct.Struct(">BBHH3s3s")
_RATES = struct.Struct(">HH")
_STATE_SHIFT = 5
MASTER = 0x10
#: By the field of the message.
_FLAGS = {"master": MASTER, "signal": 0x08, "application": 0x04, "fresh": 0x02, "sending": 0x01}


class LinkState(IntEnum):
    """How far the two ends have come; docs/wire-formats.md shows the transitions.

    CHECK: the local check has not passed.
    SEARCH: no signal, or no message in it yet.
    CONFIGURE: a matching peer is there, but the two have not agreed, or it does not hear this end.
    APPROVE: agreed, but application data has not arrived both ways yet.
    CONNECTED: application data has arrived both ways.
    REFUSED: the peer does not match.
    """

    CHECK = 0
    SEARCH = 1
    CONFIGURE = 2
    APPROVE = 3
    CONNECTED = 4
    REFUSED = 5


class MessageKind(IntEnum):
    """The purpose of a message."""

    ALIVE = 0
    CONFIGURE = 1
    CONFIRM = 2
    REJECT = 3
    HELLO = 4
    CLOCK = 5


class SupervisionMessage(NamedTuple):
    """One message.

    version: 1 to 15. boot_id, heard: docs/wire-formats.md. digest: 0 to 65535.
    signal: good frames of the peer arrive.
    application: data of the peer's applications has arrived since the contact or the last reset.
    fresh: some has arrived recently. sending: some has been sent recently.
    rates_kbps: of CONFIGURE and REJECT (way out, way in), else zeros.
    loss: of ALIVE and CONFIRM: what of the peer's frames is lost, else zeros.
    number, echo: of HELLO, 24 bits each, else 0; it has no `heard`.
    """

    version: int
    kind: MessageKind
    state: LinkState
    master: bool
    signal: bool
    application: bool
    fresh: bool
    sending: bool
    boot_id: int
    heard: int
    digest: int
    rates_kbps: tuple[int, int] = (0, 0)
    number: int = 0
    echo: int = 0
    loss: Loss = Loss()


#: Kinds of messages with rates, and with a loss.
KINDS_WITH_RATES = (MessageKind.CONFIGURE, MessageKind.REJECT)
KINDS_WITH_LOSS = (MessageKind.ALIVE, MessageKind.CONFIRM)


def pack_message(message: SupervisionMessage) -> bytes:
    """Return the twelve octets of `message`."""
    flags = message.state << _STATE_SHIFT
    flags |= sum(flag for name, flag in _FLAGS.items() if getattr(message, name))
    first = message.version << 4 | message.kind
    if message.kind is MessageKind.HELLO:
        number, echo = message.number.to_bytes(3, "big"), message.echo.to_bytes(3, "big")
        return _HELLO.pack(first, flags, message.boot_id, message.digest, number, echo)
    return _LAYOUT.pack(
        first,
        flags,
        message.boot_id,
        message.heard,
        message.digest,
        _RATES.pack(*(message.rates_kbps if message.kind in KINDS_WITH_RATES else message.loss)),
    )


def message_version(data: bytes) -> int:
    """Return the version in `data`, 1 to 15; 0 if it is no message of any version."""
    return data[0] >> 4 if len(data) == MESSAGE_OCTETS else 0


def parse_message(data: bytes) -> SupervisionMessage | None:
    """Parse `data`; None if no end that follows the layout can have sent it."""
    if not message_version(data):
        return None
    first, flags, boot_id, heard, digest, rest = _LAYOUT.unpack(data)
    kind, state = first & 0xF, flags >> _STATE_SHIFT
    master = bool(flags & MASTER)
    if (
        kind > MessageKind.HELLO
        or state > LinkState.REFUSED
        or not boot_id
        or kind == (MessageKind.CONFIRM if master else MessageKind.CONFIGURE)
    ):
        return None
    known = MessageKind(kind)
    number, echo = b"", b""
    if known is MessageKind.HELLO:
        _, _, _, digest, number, echo = _HELLO.unpack(data)
        heard = 0
    return SupervisionMessage(
        version=first >> 4,
        kind=known,
        state=LinkState(state),
        **{name: bool(flags & flag) for name, flag in _FLAGS.items()},
        boot_id=boot_id,
        heard=heard,
        digest=digest,
        rates_kbps=_RATES.unpack(rest) if known in KINDS_WITH_RATES else (0, 0),
        number=int.from_bytes(number, "big"),
        echo=int.from_bytes(echo, "big"),
        loss=Loss(*_RATES.unpack(rest)) if known in KINDS_WITH_LOSS else Loss(),
    )


class MessagePacing:
    """Messages at once on a change, fast until the peer may know it, then slowly.

    due_ns: when the next message is due. earliest_ns: none may be sent before, whatever its kind.
    """

    def __init__(self, timing: SupervisionTiming, now_ns: int) -> None:
        self.due_ns = self.earliest_ns = now_ns
        self._timing = timing
        #: What the last message contained.
        self._sent: tuple[int, ...] = ()
        self._content: tuple[int, ...] = ()
        self._changed_ns = now_ns
        self._sent_ns = now_ns - timing.slow_ns

    def handle_content(
        self, content: tuple[int, ...], now_ns: int, *, heard: bool, settled: bool
    ) -> None:
        """Update the next message. heard: the peer hears. settled: it needs nothing more."""
        timing = self._timing
        if content != self._content:
            self._content, self._changed_ns = content, now_ns
        if content != self._sent:
            wait_ns = timing.spacing_ns
        elif settled:
            wait_ns = timing.slow_ns
        elif now_ns - self._changed_ns < timing.settle_ns:
            wait_ns = timing.fast_ns
        else:
            wait_ns = timing.slow_ns if heard else timing.search_ns
        self.due_ns = max(self._sent_ns + wait_ns, self.earliest_ns)

    def handle_sent(self, content: tuple[int, ...], now_ns: int) -> None:
        self._sent, self._sent_ns = content, now_ns
        self.handle_extra(now_ns)

    def handle_extra(self, now_ns: int) -> None:
        """A message was sent that does not take the place of a regular one."""
        self.earliest_ns = now_ns + self._timing.spacing_ns
