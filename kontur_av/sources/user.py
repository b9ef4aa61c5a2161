"""A user's camera and microphone: what they raise, and nonsense, are faults of theirs. A shell."""

from typing import Any, NamedTuple

import numpy as np

from kontur_av.clock import NS_PER_S, Clock
from kontur_av.media import BLOCK_SAMPLES, AudioFrame, CaptureStamp, Tip
from kontur_av.returned import PartError, fault_of, taken
from kontur_av.sources.source import RETRY_NS, AudioSource, StampingSource, VideoSource


class _Numbers(NamedTuple):
    """What of a user's source is used beside pictures and sound."""

    faults: int
    last_fault: str
    capture_ns: int = 0


class UserSource(StampingSource):
    """A `VideoSource` or an `AudioSource` around a user's. Its stamps are made anew.

    spec: names it, in its faults, too. gives: what its `read` returns.
    """

    def __init__(
        self,
        source: VideoSource | AudioSource,
        gives: type[CaptureStamp] | type[AudioFrame],
        name: str,
        clock: Clock,
        spec: str,
    ) -> None:
        super().__init__(name, clock, spec)
        self._source, self._gives, self._told_faults = source, gives, 0

    def read(self, *arguments: Any) -> Any:
        """As the user's `read`; None after a fault, and after a pause."""
        source = self._source
        try:
            found = source.read(*arguments)
            told = taken(_Numbers, (source.faults, source.last_fault), "its counters")
            if told.faults > self._told_faults:
                self._fault(told.last_fault)
            self._told_faults = told.faults
            return None if found is None else self._checked(found)
        except Exception as error:
            self._fault(fault_of("read()", error))
            pause_ns: int = min(arguments[-1], RETRY_NS)
            self._clock.sleep_until_ns(self._clock.now_ns() + pause_ns)
            return None

    def tip(self) -> Tip | None:
        """Return where the user's camera sees the robot's tip, if its method `tip` says so."""
        try:
            tip = getattr(self._source, "tip", lambda: None)()
            return None if tip is None else taken(Tip, tip, "tip()")
        except Exception as error:
            self._fault(fault_of("tip()", error))
            return None

    def close(self) -> None:
        try:
            self._source.close()
        except Exception as error:
            self._fault(fault_of("close()", error))

    def _checked(self, found: Any) -> CaptureStamp | AudioFrame:
        if not isinstance(found, self._gives):
            raise PartError(
                f"read() returned a {type(found).__name__}: give {self._gives.__name__}"
            )
        if isinstance(found, CaptureStamp):
            return self._stamped(found.capture_ns)
        samples = np.asarray(found.samples)
        if samples.dtype != np.int16 or samples.size != BLOCK_SAMPLES:
            what = f"{samples.size} samples of {samples.dtype}"
            raise PartError(f"read() returned {what}: give {BLOCK_SAMPLES} of int16")
        return AudioFrame(samples.reshape(-1), self._stamped(found.stamp.capture_ns))

    def _stamped(self, capture: Any) -> CaptureStamp:
        capture_ns = taken(_Numbers, (0, "", capture), "read()").capture_ns
        if not 0 <= capture_ns <= self._clock.now_ns() + NS_PER_S:
            raise PartError(f"read() returned capture_ns = {capture_ns}: give clock.now_ns()")
        return self._stamp(capture_ns)
