"""The radio link: transfer frames, queues, slot multiplexer, header compression, gateway."""
