"""H.264 and Opus: settings, encoders, decoders, and how long a loss is seen."""
