"""The error of a mass air flow sensor as a map over the operating point: estimated, extrapolated, explained.

The verbs of the command line are functions here: `lpvobs.estimate(...)` and the others of `lpvobs.api`, each loaded when it is
asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lpvobs.api.calibrate import calibrate
    from lpvobs.api.compare import compare
    from lpvobs.api.estimate import estimate
    from lpvobs.api.export import export
    from lpvobs.api.export_unit import export_unit
    from lpvobs.api.extrapolate import extrapolate
    from lpvobs.api.ingest_log import draft_profile, ingest_log
    from lpvobs.api.inspect import inspect
    from lpvobs.api.read_map import read_map
    from lpvobs.api.refine import refine
    from lpvobs.api.simulate import simulate, simulate_bench
    from lpvobs.api.synth_gain import synth_gain
    from lpvobs.api.trace import trace
    from lpvobs.api.track import track
    from lpvobs.api.verify import verify
    from lpvobs.api.write_report import write_report

__version__ = "0.1.0"
ELSEWHERE = {"draft_profile": "ingest_log", "simulate_bench": "simulate"}
"""Modules of `lpvobs.api` for functions that are not in one of their own name."""
__all__ = [
    "calibrate", "compare", "draft_profile", "estimate", "export", "export_unit", "extrapolate", "ingest_log", "inspect",
    "read_map", "refine", "simulate", "simulate_bench", "synth_gain", "trace", "track", "verify", "write_report",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Return a function of `lpvobs.api`, loaded on first use: neither the command line nor one room alone pays for it."""
    if name in __all__:
        return getattr(import_module(f"lpvobs.api.{ELSEWHERE.get(name, name)}"), name)
    raise AttributeError(f"module 'lpvobs' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(["__version__", *__all__])
