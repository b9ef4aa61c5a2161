"""Make `clip.mp4`, the clip of the documents' examples: two seconds of the robot's built-in scene.

python samples/make_clip.py [DIRECTORY]                by default, this one
"""

import sys
from pathlib import Path

import av

from kontur_av.clock import NS_PER_S, ManualClock
from kontur_av.media import empty_picture
from telepresence import video_scenes

FPS, SECONDS, WIDTH, HEIGHT = 30, 2, 640, 480

folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent
clock = ManualClock()
scene = video_scenes()["head"]("head", WIDTH, HEIGHT, FPS, clock)
picture = empty_picture(WIDTH, HEIGHT)
with av.open(str(folder / "clip.mp4"), "w") as container:
    stream = container.add_stream("libx264", FPS, options={"crf": "28", "preset": "slow"})
    stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
    for _ in range(FPS * SECONDS):
        scene.read(picture, NS_PER_S)
        container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="yuv420p")))
    container.mux(stream.encode())
