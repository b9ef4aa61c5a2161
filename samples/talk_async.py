"""Send sound and hear it, in one event loop.

python samples/talk_async.py 127.0.0.1:5004 voice.sdp 3                    (SDP file, seconds)
"""

import asyncio
import sys

import numpy as np

import kontur_av as ka

to, sdp, seconds = sys.argv[1], sys.argv[2], int(sys.argv[3])
TONE = (8000 * np.sin(2 * np.pi * 440 * np.arange(48_000) / 48_000)).astype(np.int16)


async def talk() -> None:
    async with asyncio.TaskGroup() as both, ka.SoundSender(to, cap_bps=24_000, sdp=sdp) as end:
        both.create_task(listen())
        for number in range(50 * seconds):
            await end.asend(TONE.reshape(50, 960)[number % 50])


async def listen() -> None:
    async with ka.StreamReceiver(sdp) as sound:
        async for block in sound:
            print(f"{block.age_ms or 0:.0f} ms old, {block.quality.name}, peak {block.data.max()}")


asyncio.run(talk())
