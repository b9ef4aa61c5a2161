"""What is in a recording, gaps and losses included, and its lines for a terminal. A core."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from mcap.records import Attachment, Message, Metadata

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ProtocolError
from pipelines.recording.metadata import METADATA, REPAIRED, RecordingMetadata
from pipelines.recording.recorded_messages import RecorderLosses, unpack
from pipelines.recording.scan import Scan, check_format
from pipelines.session.topology.tables import Table

_UNITS = ((1_000_000_000, "GB"), (1_000_000, "MB"), (1000, "kB"))


@dataclass(slots=True)
class ChannelInventory:
    """The messages of a channel.

    octets: of all messages. first_ns, last_ns: wall time. longest_gap_ns: between two messages.
    missing: gaps in their sequence numbers; None: they do not count.
    """

    topic: str
    schema: str
    messages: int = 0
    octets: int = 0
    first_ns: int = 0
    last_ns: int = 0
    longest_gap_ns: int = 0
    missing: int | None = None
    _sequence: int = 0

    def handle_message(self, message: Message) -> None:
        """Count the next message in the order of the file."""
        log_ns = message.log_time
        if not self.messages:
            self.first_ns = self.last_ns = log_ns
        elif message.sequence > self._sequence:
            # A smaller number is that of a process that was started again.
            self.missing = (self.missing or 0) + message.sequence - self._sequence - 1
        self.longest_gap_ns = max(self.longest_gap_ns, log_ns - self.last_ns)
        self.first_ns, self.last_ns = min(self.first_ns, log_ns), max(self.last_ns, log_ns)
        self._sequence = message.sequence
        self.messages += 1
        self.octets += len(message.data)

    @property
    def rate_hz(self) -> float:
        """Messages a second, from the first to the last; 0 for fewer than two."""
        seconds = (self.last_ns - self.first_ns) / NS_PER_S
        return (self.messages - 1) / seconds if seconds else 0.0


@dataclass(frozen=True, kw_only=True)
class Inventory:
    """What is in a file.

    metadata: None if they are lost, or of another program.
    repaired: what `recover` noted of the torn file that this one was made of.
    losses: what the recorder could not keep, by its newest message.
    """

    scan: Scan
    metadata: RecordingMetadata | None
    repaired: Mapping[str, str]
    losses: RecorderLosses | None
    channels: Sequence[ChannelInventory]


def take_inventory(octets: memoryview) -> Inventory:
    """Read a file; ProtocolError if it is no MCAP file, or a recording of a newer format."""
    scan = Scan(octets)
    channels: dict[int, ChannelInventory] = {}
    metadata: RecordingMetadata | None = None
    losses: RecorderLosses | None = None
    repaired: dict[str, str] = {}
    for item in scan.items():
        if isinstance(item, Metadata):
            if item.name == METADATA:
                with suppress(ProtocolError):
                    metadata = RecordingMetadata.of(item.metadata)
            elif item.name == REPAIRED:
                repaired = item.metadata
            continue
        if isinstance(item, Attachment):
            continue
        channel = item.channel
        if channel.id not in channels:
            channels[channel.id] = ChannelInventory(channel.topic, item.kind)
        channels[channel.id].handle_message(item.message)
        if item.kind == RecorderLosses.schema.full_name:
            with suppress(ProtocolError):
                losses = unpack(RecorderLosses, item.message.data)
    check_format(scan)
    for channel in scan.channels.values():
        if channel.id not in channels:
            schema = scan.schemas.get(channel.schema_id)
            name = "" if schema is None else schema.name
            channels[channel.id] = ChannelInventory(channel.topic, name)
    return Inventory(
        scan=scan,
        metadata=metadata,
        repaired=repaired,
        losses=losses,
        channels=sorted(channels.values(), key=lambda each: each.topic),
    )


def inventory_lines(inventory: Inventory, name: str, width: int) -> list[str]:
    """Return it as text; name: of the file; width: of the terminal, in characters."""
    return [
        *_head(inventory, name),
        *_state(inventory, name),
        "",
        *_channels(inventory.channels).lines(width),
    ]


def _head(inventory: Inventory, name: str) -> Iterator[str]:
    scan, metadata = inventory.scan, inventory.metadata
    metrics = scan.metrics
    yield (
        f"{name}: {_size(metrics.octets)}, {metrics.messages} messages on "
        f"{len(inventory.channels)} channels"
    )
    if not scan.ours:
        yield f"written by {scan.library or 'an unknown program'}: not a recording of kontur-av"
    elif metadata is None:
        yield f"written by {scan.library}; its facts are lost"
    else:
        yield (
            f"session {metadata.session} of setup {metadata.setup}, part {metadata.part}, "
            f"seed {metadata.seed}, kontur-av {metadata.version}"
        )
        yield f"by `{metadata.command}`"
    filled = [channel for channel in inventory.channels if channel.messages]
    if filled:
        first_ns = min(channel.first_ns for channel in filled)
        seconds = (max(channel.last_ns for channel in filled) - first_ns) / NS_PER_S
        yield f"{seconds:.1f} s from {_utc(first_ns)}"


def _state(inventory: Inventory, name: str) -> Iterator[str]:
    metrics = inventory.scan.metrics
    fix = f"; `kontur-av recover {name}` fixes it" if inventory.scan.ours else ""
    if metrics.holes:
        places = f"{len(metrics.holes)} places" if len(metrics.holes) > 1 else "one place"
        yield (f"torn or damaged: {_size(metrics.unread_octets)} in {places} cannot be read{fix}")
    elif not metrics.closed:
        yield f"torn: its summary is missing, all that was written can be read{fix}"
    elif not metrics.sound:
        yield f"damaged, but every message can be read{fix}"
    if metrics.orphans:
        yield f"{metrics.orphans} messages of unknown channels were left out"
    if inventory.repaired:
        told = inventory.repaired
        yield (
            f"fixed: {told.get('unread_octets', '?')} of {told.get('octets', '?')} octets of the "
            "torn file could not be read"
        )
    for loss in inventory.losses.losses if inventory.losses else ():
        yield f"{loss.channel}: the recorder missed {loss.missed} and dropped {loss.dropped}"


def _channels(channels: Sequence[ChannelInventory]) -> Table:
    return Table(
        headings=("channel", "messages", "a second", "size", "longest gap", "missing", "schema"),
        rows=[
            (
                each.topic,
                str(each.messages),
                f"{each.rate_hz:.1f}" if each.rate_hz else "–",
                _size(each.octets),
                f"{each.longest_gap_ns / NS_PER_S:.3f} s" if each.messages > 1 else "–",
                "–" if each.missing is None else str(each.missing),
                each.schema or "–",
            )
            for each in channels
        ],
        spare=("size", "a second", "longest gap"),
    )


def _size(octets: int) -> str:
    for factor, unit in _UNITS:
        if octets >= factor:
            return f"{octets / factor:.1f} {unit}"
    return f"{octets} octets"


def _utc(wall_ns: int) -> str:
    if wall_ns >= 1 << 63:
        return "no instant"
    return f"{np.datetime_as_string(np.datetime64(wall_ns, 'ns'), unit='s')} UTC"
