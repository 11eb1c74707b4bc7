"""`lpvobs refine`."""

from pathlib import Path
from typing import TYPE_CHECKING

from lpvobs.cli.common import guarded, leave, print_json, progress, say
from lpvobs.cli.options import ENGINE, JSON, LOGS, MAP, argument, needed, option
from lpvobs.cli.trace import show

if TYPE_CHECKING:
    from lpvobs.api.pooled import Traced


@guarded
def refine(
    result: Path = argument("RESULT.h5", "A result of estimate."),
    logs: list[Path] = LOGS,
    out: Path = needed("REFINED.h5", "The refined result to write."),
    hold_out: list[Path] | None = option(
        "LOG",
        "A log that nothing is fitted to and no decision sees: the error is judged on it, too. Repeatable.",
        "--hold-out",
    ),
    freeze_map: bool | None = MAP,
    engine: Path | None = ENGINE,
    as_json: bool = JSON,
) -> None:
    """Add the effects that the logs prove, estimate again, and report the error before and after on data held out.

    Without a finding the model of before is written, byte for byte. A refined result can be refined again. A log that cannot be
    used is named and left out: exit code 3.

    Example: lpvobs refine nedc.h5 nedc.parquet --out refined.h5

    Example, judged on another drive: lpvobs refine nedc.h5 nedc.parquet --hold-out wltc.parquet --out refined.h5
    """
    from lpvobs.api.refine import RefineOutput
    from lpvobs.api.refine import refine as refine_model

    with progress("refining") as report:
        traced = refine_model(
            result, logs, out, hold_out=hold_out or (), freeze_map=freeze_map, engine=engine, progress=report
        )
    if as_json:
        found = vars(traced.found.output(refined=True))
        print_json("refine", RefineOutput(**found, map_frozen=traced.map_frozen, refused=traced.refused))
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
