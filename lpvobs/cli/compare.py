"""`lpvobs compare`."""

from pathlib import Path

from lpvobs.cli.common import guarded, print_json, say, table
from lpvobs.cli.options import JSON, REGION, argument, option


@guarded
def compare(
    first: Path = argument("A.h5", "A result of estimate, the earlier one; or a fleet of track."),
    second: Path | None = argument("[B.h5]", "Another result; none beside a fleet.", None),
    vehicle: str = option("NAME", "A vehicle of the fleet, of which two periods are compared.", default=""),
    period: list[str] | None = option("PERIOD", "The earlier and then the later one, such as 2025-01."),
    values: str = option("GROUP", "map: nodes that both have estimated; extrapolation: every node.", default="map"),
    region: str | None = REGION,
    gate: list[str] | None = option("EXPR", '"largest_change<=0.5 g/s", say; also mean_change, p_value. Repeatable.'),
    figure: Path | None = option("FILE.svg", "Draw the change at every node; framed: more than its error."),
    as_json: bool = JSON,
) -> None:
    """Show how map B differs from map A, and where the difference exceeds the errors of both.

    Example: lpvobs compare january.h5 june.h5 --gate "largest_change<=0.5 g/s"

    Of a fleet: lpvobs compare fleet.h5 --vehicle V1 --period 2025-01 --period 2025-10
    """
    from lpvobs.api.compare import compare as compare_maps
    from lpvobs.api.compare import expect_gates, region_of
    from lpvobs.report.tables import grams

    over = None if region is None else region_of(region)
    found = compare_maps(
        first, second, vehicle=vehicle, periods=period or (), values=values, region=over, figure=figure
    )
    if figure is not None:
        say(f"{figure}: written")
    if as_json:
        print_json("compare", found)
    else:
        low, high = (grams(end) for end in found.mean.ci90)
        where = f"in {region}" if region else f"over the {found.nodes} nodes that both have"
        print(f"mean change {where}: {grams(found.mean.value)} g/s (90 %: {low} to {high})")
        many = len(found.significant)
        print(f"p = {found.p_value:.2g} if nothing has changed; {many} nodes have changed by more than their errors")
        if found.significant:
            rows = [
                [f"{node.speed:g}", f"{node.fuel:g}", *map(grams, (node.before, node.after, node.change, *node.ci90))]
                for node in found.significant
            ]
            print(table([*found.axes, "A [g/s]", "B [g/s]", "change [g/s]", "5 %", "95 %"], rows))
    expect_gates(found, gate or ())
    if gate:
        say(f"{found.second}: every gate holds")
