"""The peer's clock: its offset and drift, measured through the link, with an error that holds."""
