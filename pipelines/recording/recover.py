"""Makes a whole file of a torn or damaged recording. A core."""

from collections.abc import Iterator

from mcap.records import Attachment, Metadata

from kontur_av.errors import ProtocolError
from kontur_av.recorded_format import FORMAT
from pipelines.recording.facts import LIBRARY, MENDED, sealed
from pipelines.recording.mcap_stream import McapStream
from pipelines.recording.scan import Scan


class Recovery:
    """What can be read of a recording, as a file that any MCAP reader opens.

    figures: what the scan of the torn file found. If they are `sound`, there is nothing to mend.

    Raises ProtocolError for octets that are not an MCAP file, and as `check_ours`.
    """

    def __init__(self, octets: memoryview) -> None:
        self._octets = octets
        scan = Scan(octets)
        for _ in scan.items():
            pass
        check_ours(scan)
        self.figures = scan.figures

    def pieces(self) -> Iterator[bytes]:
        """Yield the octets of the whole file, in order."""
        stream = McapStream(library=LIBRARY)
        scan = Scan(self._octets)
        declared: set[int] = set()
        for item in scan.items():
            if isinstance(item, Metadata):
                stream.handle_metadata(item.name, item.metadata)
            elif isinstance(item, Attachment):
                stream.handle_attachment(item)
            else:
                schema, channel, message = item
                if channel.id not in declared:
                    declared.add(channel.id)
                    stream.handle_channel(schema, channel)
                stream.handle_message(
                    channel.id,
                    message.data,
                    log_ns=message.log_time,
                    publish_ns=message.publish_time,
                    sequence=message.sequence,
                    now_ns=0,
                )
            yield from _waiting(stream)
        # Those that have no message say what was to be recorded.
        for channel in scan.channels.values():
            if channel.id not in declared:
                stream.handle_channel(scan.schemas.get(channel.schema_id), channel)
        figures = self.figures
        told = {
            "octets": figures.octets,
            "unread_octets": figures.unread_octets,
            "holes": len(figures.holes),
            "messages": figures.messages,
        }
        items = sealed(MENDED, {name: str(value) for name, value in told.items()})
        stream.handle_metadata(MENDED, items)
        stream.handle_end()
        yield from _waiting(stream)


def check_ours(scan: Scan) -> None:
    """Raise ProtocolError unless a scan that is done found a recording that can be mended."""
    check_format(scan)
    refuse_foreign(
        ours=scan.ours,
        library=scan.library,
        messages=scan.figures.messages,
    )


def refuse_foreign(*, ours: bool, library: str, messages: int) -> None:
    """Raise ProtocolError for a file that is not `ours`, or of which nothing is left.

    library: who wrote it, as its header says.
    """
    if ours:
        return
    if messages and not library.startswith(LIBRARY.split()[0]):
        raise ProtocolError(
            f"it was written by {library or 'an unknown program'}, not by kontur-av: "
            "`kontur-av info` shows what is in it"
        )
    raise ProtocolError("nothing in it can be read any more")


def check_format(scan: Scan) -> None:
    """Raise ProtocolError if a scan that is done found a recording of a newer format."""
    newer = sorted(text for text in scan.formats if not text.isdecimal() or int(text) > FORMAT)
    if newer:
        raise ProtocolError(
            f"it has format {newer[-1]}, and this kontur-av reads up to format {FORMAT}: "
            "install a newer one"
        )


def _waiting(stream: McapStream) -> Iterator[bytes]:
    while (octets := stream.poll_transmit(0)) is not None:
        yield octets
