"""`lpvobs extrapolate`."""

from pathlib import Path
from typing import Annotated

from lpvobs.cli.common import guarded, print_json, say, table
from lpvobs.cli.options import JsonOption, file_argument


@guarded
def extrapolate(
    result: Annotated[Path, file_argument("RESULT.h5", "A result of estimate; its /extrapolation is written.")],
    as_json: JsonOption = False,
) -> None:
    """Fit the quadratic of Eq. (37) to the estimated nodes and fill the nodes that no log visited.

    Example: lpvobs extrapolate nedc.h5
    """
    from lpvobs.api.extrapolate import ExtrapolateOutput, fill
    from lpvobs.report.outputs import quadratic_fields
    from lpvobs.report.tables import coefficient_tables, percent

    stored, fitted, held = fill(result)
    if as_json:
        print_json(
            "extrapolate", ExtrapolateOutput(result=str(result), outer_coverage=held, **quadratic_fields(fitted))
        )
        return
    for coefficients in coefficient_tables([("this map", stored)]):
        print(table(*coefficients))
    filled = int((fitted.support == 2).sum())
    say(f"outer estimated nodes inside their 90 % interval when fitted without them: {percent(held, 0)}")
    say(
        f"{result}: {filled} nodes filled; the surface scatters by {fitted.lack_of_fit * 1e3:.3g} g/s around the quadratic"
    )
