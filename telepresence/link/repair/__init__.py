"""Erasure repair of packet zones: idle zones carry combinations of the zones before them.

A sliding-window code over the frames of one direction, in the manner of RFC 8681 and CCSDS 131.5-O:
a lost frame is a known erasure, and the frame count chooses the coefficients. `symbols` says what
of a frame is coded, `codes` how; `encoder` fills idle zones; `decoder` solves for lost zones; and
`packets` returns whole packets, of which only those wait that a hole touches. docs/wire-formats.md
has the bits.
"""
