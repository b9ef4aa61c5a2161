"""The gateways of the radio link, and the way to another machine."""
