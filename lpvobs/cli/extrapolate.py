"""`lpvobs extrapolate`."""

from pathlib import Path

from lpvobs.cli.common import guarded, print_json, say, table
from lpvobs.cli.options import EXTRAPOLATIONS, JSON, argument, flag, option

HOW = "kriging: Eq. (37) and what the error has beyond it; quadratic: Eq. (37) alone, as in the paper."


@guarded
def extrapolate(
    result: Path = argument("RESULT.h5", "A result of estimate; /extrapolation is written into it."),
    method: str = option("NAME", HOW, offers=EXTRAPOLATIONS, default="kriging"),
    smooth: bool = flag("--smooth", "Smooth the estimated nodes as well; /extrapolation marks them."),
    as_json: bool = JSON,
) -> None:
    """Fill the nodes that no log visited, with an interval for each.

    Example: lpvobs extrapolate nedc.h5
    """
    from lpvobs.api.extrapolate import ExtrapolateOutput, fill, half_widths
    from lpvobs.report.outputs import quadratic_fields
    from lpvobs.report.tables import beside_paper, coefficient_tables, grams, percent

    stored, fitted, held = fill(result, method, smooth)
    half = half_widths(fitted)
    if as_json:
        print_json(
            "extrapolate",
            ExtrapolateOutput(result=str(result), outer_coverage=held, half_widths=half, **quadratic_fields(fitted)),
        )
        return
    for coefficients in coefficient_tables(mine := [("this map", stored)], beside_paper(mine)):
        print(table(*coefficients))
    more = f", {fitted.nodes} smoothed" if smooth else ""
    say(
        f"outer estimated nodes, left out and predicted from the others, lie inside the predicted 90 % interval: {percent(held, 0)}"
    )
    say(f"{result}: {int((fitted.support == 2).sum())} nodes filled by {fitted.method}{more}")
    if half is not None:
        say(f"their 90 % intervals: +-{grams(half[0])} g/s or less for half of them, +-{grams(half[1])} g/s at most")
