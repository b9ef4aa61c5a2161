"""GStreamer's RTSP server: run by the system's Python, which has its bindings.

    python3 media_server.py PORT|--check [USER:PASSWORD]

It takes what a client records to /arm, and writes the decoded pictures to its standard output, as
I420. It plays a test picture at /h264 and /h265, for this user alone if one is given, and a tone at
/sound.
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
SHOW = (
    "( videotestsrc is-live=true ! video/x-raw,format=I420,width=320,height=240,framerate=30/1 "
    "! {0}enc speed-preset=ultrafast tune=zerolatency key-int-max=15 bitrate=500 "
    "! rtp{1}pay name=pay0 pt=96 )"
)
MAY = "user, media.factory.access=(boolean)true, media.factory.construct=(boolean)true"
PLAYED = {
    "/h264": SHOW.format("x264", "h264"),
    "/h265": SHOW.format("x265", "h265"),
    "/sound": "( audiotestsrc is-live=true ! opusenc ! rtpopuspay name=pay0 )",
}


def main(port, user=None):
    Gst.init(None)
    factory = GstRtspServer.RTSPMediaFactory.new()
    factory.set_transport_mode(GstRtspServer.RTSPTransportMode.RECORD)
    factory.set_launch(TAKE)
    server = GstRtspServer.RTSPServer.new()
    server.set_address("127.0.0.1")
    server.set_service(port)
    server.get_mount_points().add_factory("/arm", factory)
    for path, launch in PLAYED.items():
        factory = GstRtspServer.RTSPMediaFactory.new()
        factory.set_launch(launch)
        if user:
            factory.add_role_from_structure(Gst.Structure.from_string(MAY)[0])
        server.get_mount_points().add_factory(path, factory)
    if user:
        token = GstRtspServer.RTSPToken()
        token.set_string("media.factory.role", "user")
        guard = GstRtspServer.RTSPAuth()
        guard.add_basic(GstRtspServer.RTSPAuth.make_basic(*user.split(":", 1)), token)
        server.set_auth(guard)
    server.attach(None)
    GLib.MainLoop().run()


if __name__ == "__main__" and sys.argv[1] != "--check":
    main(*sys.argv[1:])
