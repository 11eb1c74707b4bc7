"""Engines: what each of them does, and what every one offers."""
