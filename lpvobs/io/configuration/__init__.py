"""TOML files read strictly into frozen records."""
