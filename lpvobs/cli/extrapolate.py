"""`lpvobs extrapolate`."""

from pathlib import Path

from lpvobs.cli.common import guarded, print_json, say, table
from lpvobs.cli.options import EXTRAPOLATIONS, JSON, argument, flag, option

HOW = "kriging: the quadratic of Eq. (37) plus the deviations from it; quadratic: Eq. (37) alone, as in the paper."


@guarded
def extrapolate(
    result: Path = argument(
        "RESULT.h5", "A result of estimate. The filled map is written into this file as /extrapolation."
    ),
    method: str = option("NAME", HOW, offers=EXTRAPOLATIONS, default="kriging"),
    smooth: bool = flag(
        "--smooth",
        "Replace the estimated nodes in /extrapolation by smoothed values, too, and mark them there as smoothed.",
    ),
    as_json: bool = JSON,
) -> None:
    """Fill the map nodes that no log visited, and give a 90 % interval for each.

    Example: lpvobs extrapolate nedc.h5
    """
    from lpvobs.api.extrapolate import ExtrapolateOutput, fill, half_widths
    from lpvobs.report.outputs import quadratic_fields
    from lpvobs.report.tables import beside_paper, coefficient_tables, grams, percent

    stored, fitted, held = fill(result, method, smooth)
    half = half_widths(fitted)
    if as_json:
        filled = quadratic_fields(fitted)
        print_json(
            "extrapolate", ExtrapolateOutput(result=str(result), outer_coverage=held, half_widths=half, **filled)
        )
        return
    for coefficients in coefficient_tables(mine := [("this map", stored)], beside_paper(mine)):
        print(table(*coefficients))
    more = f", {fitted.nodes} smoothed" if smooth else ""
    say(
        f"check: {percent(held, 0)} of the outer estimated nodes lie inside the 90 % interval predicted from the other nodes"
    )
    say(f"{result}: {int((fitted.support == 2).sum())} nodes filled by {fitted.method}{more}")
    if half is not None:
        say(f"90 % intervals of the filled nodes: +-{grams(half[0])} g/s in the median, +-{grams(half[1])} g/s at most")
