"""Until header compression speaks in kinds: the old pair behind the new verbs."""

from typing import Any

from telepresence.link import compression as _c

RtpCompressor: Any = _c.RtpCompressor
RtpDecompressor: Any = _c.RtpDecompressor

if not hasattr(_c.RtpCompressor, "handle_acknowledgement"):

    class _Compressor(_c.RtpCompressor):  # type: ignore[misc]
        def compress(self, data: bytes, count: int) -> tuple[int, bytes, int]:
            tag, body, header = super().compress(data, count)
            return tag >> 4, body, header

        def handle_acknowledgement(self, context_id: int, count: int) -> None: ...

        def handle_peer(self, *, heard: bool) -> None: ...

        def forget(self) -> None:
            self.refresh()

    class _Decompressor(_c.RtpDecompressor):  # type: ignore[misc]
        context_id = 0

        def decompress(self, kind: int, body: bytes, count: int) -> bytes | str:
            if kind > 7:
                return "malformed"
            return super().decompress(kind << 4, body, count)

    RtpCompressor, RtpDecompressor = _Compressor, _Decompressor
