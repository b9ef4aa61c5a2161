"""The channels of a recording live, over Foxglove's WebSocket protocol.

`protocol.py` has its messages, `client.py` what waits for one client, `video.py` where a decoder
can begin, `services.py` the telecommands, `bridge.py` joins them. The messages of the channels are
the recorder's: `pipelines/recording/session_messages.py`.
"""
