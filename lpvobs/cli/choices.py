"""What shells offer behind an option; written out, because a shell does not wait until the libraries behind it are loaded."""

from collections.abc import Callable

CYCLES = ("etc", "etc_part1", "ftp75", "ftp75_cold", "nedc", "whtc", "wltc")
METHODS = ("observer", "published", "ekf", "batch")
FORMATS = ("dcm", "csv", "netcdf")
PROFILES = ("kit-obd", "liu-ice")


def offer(names: tuple[str, ...]) -> Callable[[str], list[str]]:
    """Return a function that completes one of the names; where none fits, shells complete files."""

    def fitting(incomplete: str) -> list[str]:
        return [name for name in names if name.startswith(incomplete)]

    return fitting
