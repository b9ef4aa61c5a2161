"""Real-time media for thin links: from a camera or a microphone to RTP packets, and back.

Knows no robot and no radio; useful alone.
"""

__version__ = "0.1.0"
