"""Engines: what each of them does, and what every one offers.

An engine is a folder here that exports one record, `ENGINE`, and a line in `lpvobs.engines.registry`. The record says all that the
rest of the package knows of it: `lpvobs.engines.base.EngineKind`. How to add one, in ten lines: `docs/architecture.md`; a small
engine that is complete: `tests/engines/blower.py`.
"""
