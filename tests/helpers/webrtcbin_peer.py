"""GStreamer's webrtcbin as a partner: run by the system's Python, which has its bindings.

    python3 webrtcbin_peer.py watch|publish URL TOKEN

It prints `pictures N` and `sounds N` as they come, or `sending` once it sends, until it is ended.
"""

import sys
import urllib.request

import gi

gi.require_version("Gst", "1.0")
gi.require_version("GstSdp", "1.0")
gi.require_version("GstWebRTC", "1.0")
from gi.repository import GLib, Gst, GstSdp, GstWebRTC  # noqa: E402

WATCH = "webrtcbin name=peer bundle-policy=max-bundle"
PUBLISH = (
    f"{WATCH} "
    "videotestsrc is-live=true ! video/x-raw,width=640,height=480,framerate=15/1 "
    "! x264enc tune=zerolatency key-int-max=15 bitrate=500 ! h264parse "
    "! rtph264pay config-interval=-1 ! application/x-rtp,media=video,encoding-name=H264,payload=96 "
    "! peer. "
    "audiotestsrc is-live=true ! audioconvert ! audioresample ! opusenc ! rtpopuspay "
    "! application/x-rtp,media=audio,encoding-name=OPUS,payload=97 ! peer."
)
WANTED = {
    "H264": "application/x-rtp,media=video,encoding-name=H264,payload=96,clock-rate=90000,"
    "packetization-mode=(string)1,profile-level-id=(string)42e01f",
    "OPUS": "application/x-rtp,media=audio,encoding-name=OPUS,payload=97,clock-rate=48000,"
    "encoding-params=(string)2",
}
DECODERS = {
    "H264": ("pictures", "rtph264depay ! h264parse ! avdec_h264 ! fakesink name=end sync=false"),
    "OPUS": ("sounds", "rtpopusdepay ! opusdec ! fakesink name=end sync=false"),
}


def main():
    mode, url, token = sys.argv[1:]
    Gst.init(None)
    pipeline = Gst.parse_launch(PUBLISH if mode == "publish" else f"{WATCH}")
    if not isinstance(pipeline, Gst.Pipeline):
        peer, pipeline = pipeline, Gst.Pipeline.new()
        pipeline.add(peer)
    peer = pipeline.get_by_name("peer")
    peer.connect("pad-added", show, pipeline)
    peer.connect("notify::ice-gathering-state", gathered, url, token, mode)
    peer.connect("on-negotiation-needed", offer)
    if mode == "watch":
        for caps in WANTED.values():
            direction = GstWebRTC.WebRTCRTPTransceiverDirection.RECVONLY
            peer.emit("add-transceiver", direction, Gst.Caps.from_string(caps))
    pipeline.set_state(Gst.State.PLAYING)
    loop = GLib.MainLoop()
    bus = pipeline.get_bus()
    bus.add_signal_watch()
    bus.connect("message::error", lambda _, message: (print(message.parse_error()), loop.quit()))
    loop.run()


def offer(peer):
    def offered(promise):
        # Kept until it is set: the description belongs to the reply.
        reply = promise.get_reply()
        description = reply.get_value("offer")
        peer.emit("set-local-description", description, Gst.Promise.new())

    peer.emit("create-offer", None, Gst.Promise.new_with_change_func(offered))


def gathered(peer, _, url, token, mode):
    if peer.get_property("ice-gathering-state") != GstWebRTC.WebRTCICEGatheringState.COMPLETE:
        return
    text = peer.get_property("local-description").sdp.as_text()
    headers = {"Content-Type": "application/sdp", "Authorization": f"Bearer {token}"}
    request = urllib.request.Request(url, text.encode(), headers)
    with urllib.request.urlopen(request) as answer:
        _, sdp = GstSdp.SDPMessage.new_from_text(answer.read().decode())
    said = GstWebRTC.WebRTCSessionDescription.new(GstWebRTC.WebRTCSDPType.ANSWER, sdp)
    peer.emit("set-remote-description", said, None)
    if mode == "publish":
        print("sending", flush=True)


def show(_, pad, pipeline):
    if pad.get_direction() != Gst.PadDirection.SRC:
        return
    what, words = DECODERS[pad.get_current_caps().get_structure(0).get_string("encoding-name")]
    decoder = Gst.parse_bin_from_description(words, True)
    count = 0

    def seen(*_):
        nonlocal count
        count += 1
        print(what, count, flush=True)
        return Gst.PadProbeReturn.OK

    end = decoder.get_by_name("end").get_static_pad("sink")
    end.add_probe(Gst.PadProbeType.BUFFER, seen)
    pipeline.add(decoder)
    decoder.sync_state_with_parent()
    pad.link(decoder.get_static_pad("sink"))


if __name__ == "__main__":
    main()
