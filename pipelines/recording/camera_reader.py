"""A camera that is coded by its reader while no stream carries it."""

from kontur_av.media import CaptureStamp
from kontur_av.topics.bus import Reader, TopicBus
from pipelines.recording.channels import Source
from pipelines.recording.own_pictures import CameraCoder


class CameraReader:
    """Reads the topic of one camera.

    It is joined for one picture at a time, so that a built-in scene draws only these.
    """

    def __init__(self, bus: TopicBus, source: Source, coder: CameraCoder) -> None:
        self.source = source
        self._bus, self._coder = bus, coder
        self._reader: Reader | None = None
        self._carried = True

    def handle_carried(self, carried: bool) -> None:
        """Whether a stream carries the camera, or nobody wants it."""
        if carried and not self._carried:
            self._coder.handle_pause()
            self._close()
        self._carried = carried

    def poll(self, now_ns: int) -> tuple[bytes, CaptureStamp] | None:
        """Return an access unit of a picture that is due, with its stamp, or None."""
        if self._carried:
            return None
        if self._reader is None:
            if self._coder.due(now_ns):
                self._reader = self._bus.reader(self.source.topic)
            return None
        lease = self._reader.latest()
        if lease is None:
            return None
        with lease:
            stamp = lease.stamp
            # A new reader is also given the newest picture of before.
            if not self._coder.due(stamp.capture_ns):
                return None
            unit = self._coder.encode(lease.video().data, stamp.capture_ns)
        self._close()
        return unit, stamp

    def _close(self) -> None:
        if self._reader is not None:
            self._reader.close()
            self._reader = None
