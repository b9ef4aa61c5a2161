"""Protection: machine keys, the handshake, and sealed datagrams between two gateways."""
