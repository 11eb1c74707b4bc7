"""`lpvobs extrapolate`."""

from pathlib import Path
from typing import Annotated

import typer

from lpvobs.cli.common import JsonOption, claim, guarded, print_json, say, table


@guarded
def extrapolate(
    result: Annotated[
        Path,
        typer.Argument(
            readable=False, metavar="RESULT.h5", help="A result of estimate; its /extrapolation is written."
        ),
    ],
    as_json: JsonOption = False,
) -> None:
    """Fit the quadratic of Eq. (37) to the estimated nodes and fill the nodes that no log visited.

    Example: lpvobs extrapolate nedc.h5
    """
    from lpvobs.io.results.results import read_result
    from lpvobs.report.tables import coefficient_tables, extrapolation_content, percent
    from lpvobs.api.extrapolate import extrapolate_result

    if result.is_file():
        claim(result)
    fitted, held = extrapolate_result(result)
    if as_json:
        print_json("extrapolate", {"result": str(result), "outer_coverage": held, **extrapolation_content(fitted)})
        return
    for coefficients in coefficient_tables([("this map", read_result(result))]):
        print(table(*coefficients))
    filled = int((fitted.support == 2).sum())
    say(f"outer estimated nodes inside their 90 % interval when fitted without them: {percent(held, 0)}")
    say(
        f"{result}: {filled} nodes filled; the surface scatters by {fitted.lack_of_fit * 1e3:.3g} g/s around the quadratic"
    )
