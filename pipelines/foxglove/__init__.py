"""The channels of a recording live, over Foxglove's WebSocket protocol.

`protocol.py` has its messages, `client.py` what waits for one client and where its decoders can
begin, `bridge.py` the telecommands, and joins them. The messages of the channels are the
recorder's: `pipelines/recording/session_messages.py`.
"""
