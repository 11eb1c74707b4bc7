"""Engines: what each of them does, and what every one offers.

To add one: a folder here with the records of its configuration, its channels, its LPV form and its balances (the members of
`lpvobs.engines.base.AirPath`), and an `ENGINE` in its `__init__`; a line in `lpvobs.engines.registry`; a commented configuration in
`configs`. `make schemas` writes its schema. A plant that simulates it gets a line in `lpvobs.simulation.plants`. A small engine
that is complete: `tests/engines/blower.py`.
"""
