"""A camera: `python network_camera.py PORT rtsp|http` sends a picture that moves.

rtsp: a server of rtsp-rs, at /stream, by UDP and without RTCP. http: MJPEG, at /mjpeg, for `USER`.
"""

import http.server
import sys
import time
from base64 import b64encode
from fractions import Fraction

import av
import numpy as np

USER = "bob:S3cret-1"
RAMP = np.tile(np.arange(320, dtype=np.uint8), (240, 1))


def coded(codec, pixels, **options):
    encoder = av.CodecContext.create(codec, "w")
    encoder.width, encoder.height, encoder.pix_fmt = 320, 240, pixels
    encoder.time_base, encoder.options = Fraction(1, 30), options
    for shift in range(10**9):
        frame = av.VideoFrame.from_ndarray(np.roll(RAMP, shift, 1), format="gray8")
        yield from map(bytes, encoder.encode(frame.reformat(format=pixels)))
        time.sleep(1 / 30)


class Camera(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        known = self.headers["Authorization"] == f"Basic {b64encode(USER.encode()).decode()}"
        self.send_response((200 if known else 401) if self.path == "/mjpeg" else 404)
        self.send_header("WWW-Authenticate", 'Basic realm="camera"')
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=picture")
        self.end_headers()
        for jpeg in coded("mjpeg", "yuvj420p") if known else ():
            head = f"--picture\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}"
            self.wfile.write(head.encode() + b"\r\n\r\n" + jpeg + b"\r\n")


if __name__ == "__main__" and sys.argv[2] == "http":
    http.server.ThreadingHTTPServer(("127.0.0.1", int(sys.argv[1])), Camera).serve_forever()
elif __name__ == "__main__":
    import rtsp

    server = rtsp.Server(f"127.0.0.1:{sys.argv[1]}")
    server.start()
    for unit in coded("libx264", "yuv420p", preset="ultrafast", tune="zerolatency", g="15"):
        server.send_frame(unit, 3000)
