"""The processes of a session, one module each; every one is a thin shell around a core."""
