"""The samples of the topics that are recorded, in an order in which no answer comes first."""

from collections.abc import Iterator, Sequence
from itertools import chain
from typing import NamedTuple

from kontur_av.media import CaptureStamp
from kontur_av.topics.bus import Reader
from pipelines.recording.channels import Source


class TopicSample(NamedTuple):
    """A sample, as read. published_ns: on the session's clock."""

    source: Source
    octets: bytes
    stamp: CaptureStamp
    published_ns: int


def waiting_samples(readers: Sequence[tuple[Source, Reader]]) -> Iterator[TopicSample]:
    """Return what waits in the topics, in their order; a report is behind its telecommand.

    readers: in the order of `sources_of`, that is telecommands first. The last one is read first:
    what answers is published later, so what it answers waits by the time that its topic is read.
    """
    read = [list(_samples(source, reader)) for source, reader in reversed(readers)]
    return chain.from_iterable(reversed(read))


def _samples(source: Source, reader: Reader) -> Iterator[TopicSample]:
    while (lease := reader.next()) is not None:
        with lease:
            yield TopicSample(source, lease.octets(), lease.stamp, lease.published_ns)
