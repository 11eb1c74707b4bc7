"""The error of a mass air flow sensor as a map over the operating point: estimated, extrapolated, explained.

The verbs of the command line are functions here: `lpvobs.estimate(...)` and the others of `lpvobs.api`, which is loaded when the
first of them is asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lpvobs.api import (
        draft_profile,
        estimate,
        export,
        extrapolate,
        ingest,
        inspect,
        read_map,
        refine,
        simulate,
        synth_gain,
        trace,
        verify,
        write_report,
    )

__version__ = "0.1.0"
__all__ = [
    "draft_profile",
    "estimate",
    "export",
    "extrapolate",
    "ingest",
    "inspect",
    "read_map",
    "refine",
    "simulate",
    "synth_gain",
    "trace",
    "verify",
    "write_report",
]


def __getattr__(name: str) -> Any:
    """Return a function of `lpvobs.api`, loaded on first use: neither the command line nor one room alone pays for it."""
    if name in __all__:
        return getattr(import_module("lpvobs.api"), name)
    raise AttributeError(f"module 'lpvobs' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
