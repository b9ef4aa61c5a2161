"""A camera that is coded by its reader: while no stream carries it, or always and whole."""

from kontur_av.media import CaptureStamp
from kontur_av.topics.bus import Reader, TopicBus
from pipelines.recording.camera_coder import CameraCoder
from pipelines.recording.channels import Source

#: Unread pictures that are kept of a camera that is coded whole: a quarter of a second at 30 Hz.
_DEPTH = 8


class CameraReader:
    """Reads the topic of one camera.

    It is joined for one picture at a time, so that a built-in scene draws only these. A topic
    gives a new reader its newest picture, which is from before it joined: that is left out.

    whole: every picture is coded, whether a stream carries the camera or not.
    """

    def __init__(
        self,
        bus: TopicBus,
        source: Source,
        coder: CameraCoder,
        now_ns: int,
        *,
        whole: bool = False,
    ) -> None:
        self.source = source
        self._bus, self._coder = bus, coder
        self._reader: Reader | None = None
        self._carried = True
        self._joined_ns = now_ns
        self._every = bus.reader(source.topic, depth=_DEPTH) if whole else None

    def handle_carried(self, carried: bool) -> None:
        """Whether a stream carries the camera, or nobody wants it."""
        if carried and not self._carried:
            self._coder.handle_pause()
            self._close()
        self._carried = carried

    def poll(self, now_ns: int) -> tuple[bytes, CaptureStamp] | None:
        """Return an access unit of a picture that is due, with its stamp, or None."""
        if self._every is not None:
            lease = self._every.next()
            if lease is None:
                return None
            with lease:
                if lease.published_ns < self._joined_ns:
                    return None
                return self._coder.encode(lease.video().data, lease.stamp.capture_ns), lease.stamp
        if self._carried:
            return None
        if self._reader is None:
            if self._coder.due(now_ns):
                self._reader = self._bus.reader(self.source.topic)
                self._joined_ns = now_ns
            return None
        lease = self._reader.latest()
        if lease is None:
            return None
        with lease:
            stamp = lease.stamp
            if lease.published_ns < self._joined_ns or not self._coder.due(stamp.capture_ns):
                return None
            unit = self._coder.encode(lease.video().data, stamp.capture_ns)
        self._close()
        return unit, stamp

    def _close(self) -> None:
        if self._reader is not None:
            self._reader.close()
            self._reader = None
