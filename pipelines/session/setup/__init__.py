"""What a user may choose: the typed table, its TOML file, and the setups built in."""
