"""WebRTC: media with a partner across the Internet. ICE, DTLS-SRTP and SDP are aiortc's."""
