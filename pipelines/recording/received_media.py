"""Receives a stream in real time: pictures or sound, figures, perhaps a file and a player."""

import selectors
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from heapq import heappop, heappush

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.codecs.decoder import DecodedPicture
from kontur_av.errors import ProtocolError
from kontur_av.media import AUDIO_CLOCK_HZ
from kontur_av.meters import Histogram, RateMeter
from kontur_av.modular import serial_difference
from kontur_av.report import latency_ms, rates
from kontur_av.rtp.annex_b import split_annex_b
from kontur_av.rtp.arrivals import MOST_REORDER_NS
from kontur_av.rtp.nal_formats import NAL_FORMATS
from kontur_av.rtp.payload_opus import opus_samples
from kontur_av.rtp.receiver import RtpReceived
from kontur_av.rtp.sdp import StreamDescription
from kontur_av.rtp.wire import TimestampUnwrapper
from kontur_av.streams.decoding import PictureDecoding, SoundDecoding
from kontur_av.streams.loudspeaker import Loudspeaker
from kontur_av.streams.udp import UdpReceiver
from pipelines.media.rtp_reports import OutputReport, ReceivedLatency, ReceivedStages, ReceiveReport
from pipelines.recording.live_output import LiveWriter
from pipelines.recording.matroska import MatroskaWriter
from pipelines.recording.raw_pictures import RawPictures
from pipelines.session.command_process import reader_gone, say, stopped_by_signals

#: What a timestamp may run ahead of its arrival, or behind it: a picture's and a sound's.
_PICTURE_S, _SOUND_TICKS = 10, AUDIO_CLOCK_HZ // 4


class TimeLine:
    """Pictures' timestamps as ticks since the first; they rise on when the sender begins anew."""

    def __init__(self, rate_hz: int) -> None:
        self._rate_hz = rate_hz
        self._most = rate_hz * _PICTURE_S
        self._unwrapper = TimestampUnwrapper()
        self._base = self._last = self._largest = 0
        self._last_ns: int | None = None

    def ticks(self, timestamp: int, now_ns: int, *, follows_all: bool) -> int:
        """follows_all: it is shown after all before it, as a key picture is."""
        ticks = self._base + self._unwrapper.unwrap(timestamp)
        if self._last_ns is not None:
            passed = (now_ns - self._last_ns) * self._rate_hz // NS_PER_S
            if (
                (follows_all and ticks <= self._largest)
                or ticks < self._last - self._rate_hz
                or abs(ticks - self._last - passed) > self._most
            ):
                self._unwrapper = TimestampUnwrapper()
                self._base = self._largest + max(passed, 1)
                ticks = self._base + self._unwrapper.unwrap(timestamp)
        self._last, self._last_ns = ticks, now_ns
        self._largest = max(self._largest, ticks)
        return ticks


class SoundLine:
    """The packets of a sound as they came, in their order, on a time line without leaps. A core.

    Which of them were played does not matter. A missing packet has 200 ms to come. After a packet
    that is late the next ones tell whether the network stalled, or the sender paused.
    """

    def __init__(self) -> None:
        self._waiting: list[tuple[int, RtpReceived]] = []
        self._next = 0
        #: Of the newest packet: timestamp, instant, length, arrival. No timestamp: a source begins.
        self._stamp: int | None = None
        self._ticks = self._samples = self._due = 0

    def packets(
        self, came: Iterable[RtpReceived], now_ns: int | None
    ) -> Iterator[tuple[bytes, int, int]]:
        """Yield Opus packets, ticks of 48 kHz and samples. now_ns: None at the end of all."""
        for packet in came:
            if packet.restart:
                yield from self._ready(None)
                self._next, self._stamp = packet.extended_sequence, None
            heappush(self._waiting, (packet.extended_sequence, packet))
        yield from self._ready(now_ns)

    def _ready(self, now_ns: int | None) -> Iterator[tuple[bytes, int, int]]:
        while self._waiting:
            sequence, packet = self._waiting[0]
            overdue = now_ns is None or now_ns - packet.received_ns >= MOST_REORDER_NS
            late = self._late(packet)
            stalled = late > _SOUND_TICKS and any(
                abs(self._late(one)) <= _SOUND_TICKS for _, one in self._waiting
            )
            if not overdue and (sequence > self._next or (late > _SOUND_TICKS and not stalled)):
                return
            heappop(self._waiting)
            if sequence < self._next:
                continue
            self._next = sequence + 1
            with suppress(ProtocolError):
                samples = opus_samples(packet.payload)
                passed = _arrival(packet) - self._due
                short = passed - late <= self._samples * 3 // 4
                leaps = abs(late) > _SOUND_TICKS and not stalled
                if self._stamp is None or short or leaps:
                    late = min(0, passed - self._samples) if self._samples else passed
                self._ticks += passed - late
                self._due += passed - late if stalled else passed
                self._stamp, self._samples = packet.timestamp, samples
                yield packet.payload, self._ticks, samples

    def _late(self, packet: RtpReceived) -> int:
        """By how many ticks it came later than its timestamp says."""
        if self._stamp is None:
            return 0
        return _arrival(packet) - self._due - serial_difference(packet.timestamp - self._stamp)


def _arrival(packet: RtpReceived) -> int:
    return packet.received_ns * AUDIO_CLOCK_HZ // NS_PER_S


class PictureOutput:
    """Decodes the pictures of its receiver. received_ns, decoded_ns: since the capture."""

    def __init__(
        self,
        stream: StreamDescription,
        clock: MonotonicClock,
        writers: Sequence[MatroskaWriter | LiveWriter],
        raw: RawPictures | None = None,
    ) -> None:
        self._decoding = PictureDecoding(stream, clock)
        self._form = NAL_FORMATS[stream.codec]
        self.receiver = self._decoding.receiver
        self.decoded_ns = Histogram()
        self.received_ns = Histogram()
        self._clock = clock
        self._raw = raw
        self._time_line = TimeLine(stream.clock_rate_hz)
        self._writers = writers
        self._size: tuple[int, int] | None = None
        #: The types of NAL units that came before the first picture.
        self._came: set[int] = set()

    @property
    def decoded(self) -> int:
        return self._decoding.decoder.counts.frames_decoded

    def drain(self) -> None:
        for unit, pictures in self._decoding.units():
            capture_ns = self.receiver.capture_ns(unit.timestamp)
            if capture_ns is not None:
                self.received_ns.add(unit.received_ns - capture_ns)
            if not self.decoded:
                self._came.update(map(self._form.nal_type, split_annex_b(unit.data)))
            for picture, stamp in pictures:
                self._show(picture)
                if stamp is not None:
                    self.decoded_ns.add(self._clock.now_ns() - stamp.capture_ns)
            ticks = self._time_line.ticks(
                unit.timestamp, unit.received_ns, follows_all=unit.keyframe
            )
            for writer in self._writers:
                writer.add_unit(unit.data, ticks, keyframe=unit.keyframe)
                if writer.needs_key:
                    self.receiver.handle_new_viewer()

    def finish(self) -> None:
        """Show the pictures that the decoder has held back."""
        for picture, _ in self._decoding.rest():
            self._show(picture)

    def missing(self) -> str:
        """Say what the decoder waits for; "" where that is not known."""
        wanted = self._form.set_names.items()
        names = [f"no {name}" for kind, name in wanted if kind not in self._came]
        if names:
            return f": {' and '.join(names)} came, in the stream or in the SDP"
        refused = self._decoding.decoder.counts.sets_refused
        return ": its SPS is malformed, or asks for too much memory" if refused else ""

    def _show(self, picture: DecodedPicture) -> None:
        if self._raw is not None:
            self._raw.handle_picture(picture)
        self._size = (picture.width, picture.height)

    def report(self) -> OutputReport:
        decoder = self._decoding.decoder.counts
        return OutputReport(video=self.receiver.counts, decoder=decoder, size=self._size)


class SoundOutput:
    """Plays the sound of its receiver. received_ns, decoded_ns: since the capture."""

    def __init__(
        self,
        stream: StreamDescription,
        clock: MonotonicClock,
        writers: Sequence[MatroskaWriter | LiveWriter],
        loudspeaker: Loudspeaker | None = None,
    ) -> None:
        self._decoding = SoundDecoding(stream, clock)
        self.receiver = self._decoding.receiver
        self.decoded_ns = Histogram()
        self.received_ns = Histogram()
        self.decoded = 0
        self._clock, self._line = clock, SoundLine()
        self._writers, self._loudspeaker = writers, loudspeaker
        self.player_ns = Histogram()

    def drain(self) -> None:
        receiver = self.receiver
        arrivals = receiver.take_arrivals()
        for packet in arrivals:
            capture_ns = receiver.capture_ns(packet.timestamp)
            if capture_ns is not None:
                self.received_ns.add(packet.received_ns - capture_ns)
        self._write(arrivals, self._clock.now_ns())
        for block, sound, decoded, stamp in self._decoding.blocks():
            self.decoded += decoded
            if self._loudspeaker is not None:
                delay_ns = self._loudspeaker.play(sound)
                if delay_ns is not None:
                    self.player_ns.add(delay_ns)
            if decoded and stamp is not None:
                self.decoded_ns.add(block.play_ns - stamp.capture_ns)

    def finish(self) -> None:
        """Write the packets that wait for a missing one."""
        self._write((), None)

    def _write(self, came: Iterable[RtpReceived], now_ns: int | None) -> None:
        for payload, ticks, samples in self._line.packets(came, now_ns):
            for writer in self._writers:
                writer.add_opus(payload, ticks, samples)

    def missing(self) -> str:
        """Nothing: each packet of sound can be decoded alone."""
        return ""

    def report(self) -> OutputReport:
        return OutputReport(voice=self.receiver.counts)


_SILENCE_NS = 5 * NS_PER_S
_SILENCE_AFTER_GOODBYE_NS = NS_PER_S
_LONGEST_WAIT_NS = 200 * NS_PER_MS


class ReceiveShell:
    """Drives sockets and receiver in real time."""

    def __init__(
        self,
        stream: StreamDescription,
        output: PictureOutput | SoundOutput,
        udp: UdpReceiver,
        clock: MonotonicClock,
        raw: RawPictures | None,
    ) -> None:
        self._raw = raw
        self._watched: int | None = None
        self._stream = stream
        self._clock = clock
        self._output = output
        self._receiver = output.receiver
        self._udp = udp
        self._rate = RateMeter()
        self._last_packet_ns: int | None = None
        self._payload_octets = 0

    def run(self, seconds: float | None) -> ReceiveReport:
        """Receive until the end; the report, without the outputs."""
        start_ns = self._clock.now_ns()
        end_ns = None if seconds is None else start_ns + round(seconds * NS_PER_S)
        next_line_ns, looked_ns = start_ns + NS_PER_S, start_ns
        say(f"waiting for {self._stream.kind} on UDP port {self._stream.port}")
        with stopped_by_signals() as stopped, selectors.DefaultSelector() as selector:
            for socket in self._udp.sockets:
                selector.register(socket, selectors.EVENT_READ)
            while not (stopped() or reader_gone()):
                now_ns = self._clock.now_ns()
                # What came during a stall of this process has not been read yet.
                if self._has_ended(looked_ns) if end_ns is None else now_ns >= end_ns:
                    break
                if now_ns >= next_line_ns:
                    next_line_ns += NS_PER_S
                    self._line(now_ns - start_ns)
                due = [self._receiver.poll_timeout(), end_ns]
                until_ns = min([next_line_ns, *(d for d in due if d is not None)])
                wait_ns = min(max(until_ns - now_ns, 0), _LONGEST_WAIT_NS)
                if self._raw is not None:
                    self._watch(selector, self._raw.pending())
                selector.select(wait_ns / NS_PER_S)
                looked_ns = self._clock.now_ns()
                self._udp.exchange(self._receiver, self._clock)
                self._note(self._clock.now_ns())
                self._output.drain()
                if self._raw is not None and self._raw.pending() is not None:
                    self._raw.handle_writable()
            self._output.finish()
        return self._report(start_ns)

    def _watch(self, selector: selectors.BaseSelector, wanted: int | None) -> None:
        """Wake when the reader of raw pictures can take the rest of a picture."""
        if self._watched is not None:
            # The descriptor may have been closed, or another one of its number opened.
            with suppress(KeyError, ValueError):
                selector.unregister(self._watched)
        if wanted is not None:
            selector.register(wanted, selectors.EVENT_WRITE)
        self._watched = wanted

    def _has_ended(self, now_ns: int) -> bool:
        if self._last_packet_ns is None:
            return False
        ended = self._receiver.ended
        timeout_ns = _SILENCE_AFTER_GOODBYE_NS if ended else _SILENCE_NS
        return now_ns - self._last_packet_ns > timeout_ns

    def _note(self, now_ns: int) -> None:
        """Count the payload that has come since the last call."""
        octets = self._receiver.counts.rtp.rtp_payload_octets
        if octets > self._payload_octets:
            self._last_packet_ns = now_ns
            self._rate.add(now_ns, octets - self._payload_octets)
            self._payload_octets = octets

    def _line(self, passed_ns: int) -> None:
        counts = self._receiver.counts.rtp
        latency = self._output.decoded_ns
        say(
            f"{passed_ns / NS_PER_S:6.0f} s  {counts.rtp_packets} packets, {counts.rtp_lost} lost, "
            f"{self._output.decoded} decoded, {self._rate.mean_bps() / 1000:.1f} kbit/s"
            + (
                f", latency {latency.percentile(95) / NS_PER_MS:.1f} ms (95 %)"
                if latency.count
                else ""
            )
        )

    def _report(self, start_ns: int) -> ReceiveReport:
        counts, rate, output = self._receiver.counts.rtp, self._rate, self._output
        latency = None
        if output.decoded_ns.count:
            latency = ReceivedLatency(
                **output.decoded_ns.summary_ms(),
                stages=ReceivedStages(capture_to_received=latency_ms(output.received_ns)),
                clock="the wall clocks of both hosts",
            )
        failed = []
        if not counts.rtp_packets:
            failed.append(f"no packet came to UDP port {self._stream.port}: {self._what_came()}")
        elif not output.decoded:
            failed.append(
                f"{counts.rtp_packets} packets came, but nothing could be decoded"
                + self._output.missing()
            )
        return ReceiveReport(
            stream=self._stream.kind,
            seconds=(self._clock.now_ns() - start_ns) / NS_PER_S,
            seconds_of_stream=((rate.last_ns or 0) - (rate.first_ns or 0)) / NS_PER_S,
            **rates(rate),
            output=output.report(),
            latency_ms=latency,
            cpu_s=0.0,
            failed=failed,
        )

    def _what_came(self) -> str:
        """Say what came instead of the stream's packets."""
        counts, other = self._receiver.counts.rtp, self._receiver.other_payload_type
        if other is not None:
            return (
                f"those that came have payload type {other}, not the {self._stream.payload_type} "
                "of the SDP: take the sender's SDP"
            )
        if self._udp.reported:
            return "only the sender's reports came (RTCP): is there a firewall before this port?"
        if counts.garbage:
            return f"{counts.garbage} datagrams came that are not RTP"
        return "is the sender running?"
