"""`lpvobs trace`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lpvobs.cli.common import JsonOption, claim, guarded, print_json, progress, say, table

if TYPE_CHECKING:
    from lpvobs.discovery.outcome import Trace

MapOption = Annotated[
    bool | None,
    typer.Option(
        "--freeze-map/--free-map",
        help="The map stands, or is estimated together with the effects. By default it stands on logs that did not make it.",
    ),
]


@guarded
def trace(
    result: Annotated[Path, typer.Argument(metavar="RESULT.h5", help="A result of estimate; its /trace is written.")],
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Parquet logs.")],
    freeze_map: MapOption = None,
    as_json: JsonOption = False,
) -> None:
    """Find the residual that the model leaves, and the effects it lacks, ranked.

    Example: lpvobs trace nominal.h5 nedc.parquet
    """
    from lpvobs.steps.trace import Sources, trace_result

    if result.is_file():
        claim(result)
    with progress("tracing") as report:
        found, frozen = trace_result(Sources(result, logs, (), freeze_map), report)
    if as_json:
        print_json("trace", {"map_frozen": frozen, **found.as_json(refined=False)})
        return
    show(found, frozen)
    say(f"held-out residual {1e3 * found.comparison.before:.3f} g/s rms; /trace written into {result}")


def show(found: "Trace", frozen: bool) -> None:
    """Print the verdict, the effects and the ranking."""
    print(f"verdict: {found.verdict} (map {'frozen' if frozen else 'estimated jointly'})")
    for finding in found.findings:
        sizes = ", ".join(
            f"{name} = {p.value:.4g} {p.unit} (90 %: {p.ci90[0]:.4g} to {p.ci90[1]:.4g})"
            for name, p in finding.parameters.items()
        )
        when = "" if finding.onset is None else f", from {finding.onset:.1f} s"
        alike = f"; cannot be told from {', '.join(finding.indistinguishable)}" if finding.indistinguishable else ""
        print(f"  {finding.id}: {sizes}{when}, p = {finding.p_value:.2g}{alike}")
    rows = [[item.id, f"{item.value:.4g}", item.unit, f"{item.gain:.1f}"] for item in found.ranking[:8]]
    if rows:
        print(table(["candidate alone", "size", "unit", "evidence"], rows))
