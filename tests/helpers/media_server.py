"""GStreamer's RTSP server: run by the system's Python, which has its bindings.

    python3 media_server.py PORT|--check

It takes what a client records to /arm, and writes the decoded pictures to its standard output, as
I420.
"""

import sys

import gi

gi.require_version("Gst", "1.0")
gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, Gst, GstRtspServer  # noqa: E402

TAKE = (
    "( rtph264depay name=depay0 ! h264parse ! avdec_h264 max-threads=1 "
    "! video/x-raw,format=I420 ! fdsink fd=1 sync=false )"
)


def main(port):
    Gst.init(None)
    factory = GstRtspServer.RTSPMediaFactory.new()
    factory.set_transport_mode(GstRtspServer.RTSPTransportMode.RECORD)
    factory.set_launch(TAKE)
    server = GstRtspServer.RTSPServer.new()
    server.set_address("127.0.0.1")
    server.set_service(port)
    server.get_mount_points().add_factory("/arm", factory)
    server.attach(None)
    GLib.MainLoop().run()


if __name__ == "__main__" and sys.argv[1] != "--check":
    main(sys.argv[1])
