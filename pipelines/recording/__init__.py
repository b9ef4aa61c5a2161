"""The recording of a session: an MCAP file that other tools open, and that outlives a kill.

`schemas.py` and `messages.py` say what a message holds, `channels.py` what is recorded,
`mcap_stream.py` writes, `scan.py` reads any octets, torn ones too. Format and words:
https://mcap.dev/spec.
"""
