"""The verbs as functions: what the command line does, from Python, with the same files and the same errors.

Each function is the step behind a verb. Files are claimed while they are written, so that two programs do not write the same one,
and appear whole or not at all. What fails raises a class of `lpvobs.errors`: `UsageError` (the configuration or the arguments),
`DataError` (a log, gain or result), `NotProven` (a certificate or a gate), each with one line that names the remedy.

A number is the same to the last bit as that of the command line if the linear algebra runs on one thread there and here:
`OPENBLAS_NUM_THREADS=1`, set before NumPy is imported. `jobs` above 1 starts processes that import the main module: keep the
calls under `if __name__ == "__main__":` then.

The report's function is called `write_report`, because `lpvobs.report` is the room that draws it.
"""

from lpvobs.api.drives import draft_profile, ingest, inspect, simulate
from lpvobs.api.effects import refine, trace
from lpvobs.api.gains import synth_gain, verify
from lpvobs.api.maps import estimate, extrapolate, read_map
from lpvobs.api.products import export, write_report

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
