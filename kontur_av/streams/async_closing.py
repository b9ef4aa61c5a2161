"""What is closed at the end of an `async with`."""

from typing import Self

from kontur_av.closing import Closing


class AsyncClosing(Closing):
    """Closed at the end of an `async with`, too, while the event loop goes on."""

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *error: object) -> None:
        import asyncio

        await asyncio.to_thread(self.__exit__, *error)
