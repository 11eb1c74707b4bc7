"""The error of a mass air flow sensor as a map over the operating point: estimated, extrapolated, explained."""

__version__ = "0.1.0"
