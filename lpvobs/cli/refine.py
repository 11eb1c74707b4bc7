"""`lpvobs refine`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lpvobs.cli.common import JsonOption, LogsArgument, guarded, leave, print_json, progress, say
from lpvobs.cli.trace import MapOption, content, show

if TYPE_CHECKING:
    from lpvobs.api.pooled import Traced


@guarded
def refine(
    result: Annotated[Path, typer.Argument(readable=False, metavar="RESULT.h5", help="A result of estimate.")],
    logs: LogsArgument,
    out: Annotated[Path, typer.Option(readable=False, metavar="REFINED.h5", help="The refined result to write.")],
    hold_out: Annotated[
        list[Path] | None,
        typer.Option(
            "--hold-out",
            readable=False,
            metavar="LOG",
            help="A log that nothing is fitted to and no decision sees: the error is judged on it, too. Repeatable.",
        ),
    ] = None,
    freeze_map: MapOption = None,
    as_json: JsonOption = False,
) -> None:
    """Add the effects that the logs prove, estimate again, and report the error before and after on data held out.

    Without a finding the model of before is written, byte for byte. A refined result can be refined again. A log that cannot be
    used is named and left out: exit code 3.

    Example: lpvobs refine nedc.h5 nedc.parquet --out refined.h5

    Example, judged on another drive: lpvobs refine nedc.h5 nedc.parquet --hold-out wltc.parquet --out refined.h5
    """
    from lpvobs.api.refine import refine as refine_model

    with progress("refining") as report:
        traced = refine_model(result, logs, out, hold_out=hold_out or (), freeze_map=freeze_map, progress=report)
    if as_json:
        print_json("refine", content(traced, refined=True))
    else:
        _tell(traced, out)
    leave(traced.refused)


def _tell(traced: "Traced", out: Path) -> None:
    found = traced.found
    show(found, traced.map_frozen, refined=True)
    error = found.comparison
    low, high = error.ratio_ci90
    say(
        f"held-out residual {1e3 * error.before:.3f} -> {1e3 * error.after:.3f} g/s rms, "
        f"ratio {error.ratio:.3f} ({low:.3f} to {high:.3f})"
    )
    say(f"{out}: " + ("written with the effects" if found.findings else "the model of before, nothing was proven"))
