"""The path between gateways on two machines: where the peer is, and what is taken from there."""
