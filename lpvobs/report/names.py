"""How cycles and methods are called where a person reads them, and what the paper reports for them."""

from pathlib import Path

from lpvobs.engines.registry import ENGINES

CYCLES = {
    "etc": "ETC surrogate",
    "etc_part1": "ETC surrogate, part 1",
    "ftp75": "FTP75",
    "ftp75_cold": "FTP75 cold transient",
    "nedc": "NEDC",
    "whtc": "WHTC",
    "wltc": "WLTC",
}
SURROGATE = "ETC surrogate"

METHODS = {
    "observer": "default settings",
    "published": "published settings",
    "ekf": "extended Kalman filter",
    "batch": "batch least squares",
}


def cycle_title(log: str) -> str:
    """Return the name of a log for people; a cycle that stands in for the ETC is called so.

    Examples
    --------
    >>> cycle_title("etc_part1")
    'ETC surrogate, part 1'
    >>> cycle_title("etc_b")
    'ETC surrogate (etc_b)'
    >>> cycle_title("road_17")
    'road_17'
    """
    if known := _cycle_of(log):
        return CYCLES[known] if known == log else f"{CYCLES[known]} ({log})"
    return f"{SURROGATE} ({log})" if log.startswith("etc") else log


def method_title(method: str) -> str:
    """Return what a method is for a reader who does not know its identifier."""
    return METHODS.get(method, f"method {method}")


def paper_error(air_path: str, log: str) -> float | None:
    """Return the mean relative error that is printed for the engine and the cycle that a log is named after, or None."""
    printed = ENGINES[air_path].published if air_path in ENGINES else None
    return None if printed is None else printed.errors.get(_cycle_of(log) or "")


def distinct(paths: list[Path]) -> list[str]:
    """Return a name for each file: its stem, or its whole path where two stems are alike."""
    stems = [path.stem for path in paths]
    return [stem if stems.count(stem) == 1 else str(path) for stem, path in zip(stems, paths, strict=True)]


def _cycle_of(log: str) -> str | None:
    """Return the longest cycle name that the log's name is, or begins with before `_` or `-`."""
    fits = [name for name in CYCLES if log == name or log.startswith((f"{name}_", f"{name}-"))]
    return max(fits, key=len, default=None)
