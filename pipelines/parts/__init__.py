"""The processes of a session, one module each: thin shells around cores."""
