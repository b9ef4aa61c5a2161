"""H.264 and Opus: settings, encoders, decoders, and what heals after a loss."""
