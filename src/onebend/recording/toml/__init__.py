"""`recording.toml`: the schema, one frozen record a table, and checks for what is possible but implausible."""
