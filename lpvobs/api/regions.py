"""Regions of a map as people type them."""

from lpvobs.errors import UsageError


def region_of(text: str) -> dict[str, tuple[float, float]]:
    """Return from and to by the name of an axis, of `n_e=1500:2500,u_delta=8:24`; raises UsageError for anything else."""
    found = {}
    for part in text.split(","):
        name, _, ends = part.partition("=")
        low, _, high = ends.partition(":")
        try:
            found[name.strip()] = (float(low), float(high))
        except ValueError:
            raise UsageError(
                f"--region {text}: expected AXIS=FROM:TO, for example n_e=1500:2500,u_delta=8:24"
            ) from None
    return found
