"""A throttled spark-ignition engine with intercooler."""
