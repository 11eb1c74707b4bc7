"""`lpvobs export`."""

from functools import partial
from pathlib import Path

from lpvobs.cli.common import print_json, say, table
from lpvobs.cli.options import ENGINE, FORMATS, JSON, MAP_GAINS, UNITS, argument, flag, needed, option
from lpvobs.errors import UsageError

WHAT = "dcm, cdfx, csv or netcdf: the map; lab: a label list for INCA; c99 or fmu: the observer for a control unit."


def export(
    result: Path = argument("RESULT.h5", "A result of estimate. For c99 and fmu: an observer gain made by synth-gain."),
    file_format: str = needed("FORMAT", WHAT, "--format", offers=FORMATS),
    out: Path = needed("FILE", "The file to write. For c99: the folder to write."),
    start: Path | None = argument(
        "[RESULT.h5]",
        "For c99 and fmu: a result of estimate. The observer starts with its map and engine.",
        default=None,
    ),
    source: str = option(
        "GROUP",
        "Which values to export: map or extrapolation. By default extrapolation if the result has one, else map.",
        "--values",
        default="",
    ),
    only_estimated: bool = flag(
        "--only-estimated", "Export estimated nodes only. Other nodes keep their value from --old, or stay empty."
    ),
    old: Path | None = option(
        "OLD.dcm", "A DCM with the old map. The export keeps its axes, units and kind of map, and lists the changes."
    ),
    name: str = option("LABEL", "Label of the map, in the exported file and in the old one.", default="delta_W_c"),
    a2l: Path | None = option(
        "FILE.a2l",
        "The control unit's A2L description, from which axes, units, limits and rounding of the map are taken. Needs lpvobs[a2l].",
    ),
    unit: str = option(
        "UNIT",
        "Unit of the values: a flow such as kg/h, mg/stroke, % of the reading, or factor: truth is reading times factor.",
        offers=UNITS,
        default="",
    ),
    kind: str = option(
        "KIND",
        "Kind of map in a DCM: KENNFELD or GRUPPENKENNFELD. By default the kind of the old map, else KENNFELD.",
        default="",
    ),
    digits: int = option("N", "Significant digits of the numbers in dcm and csv.", default=7),
    engine: Path | None = ENGINE,
    map_gain: str = option(
        "GAIN",
        "For c99 and fmu: whether the map gain Gamma is constant or falls with the time driven. By default it falls, if the "
        "observer gain is proven for a falling Gamma.",
        offers=MAP_GAINS,
        default="",
    ),
    rate: float = option(
        "HZ", "For c99 and fmu: the highest sample rate of the signals, in samples per second.", default=100.0
    ),
    widest: float = option(
        "SHARE",
        "Leave out nodes whose 90 % interval has a half-width above this share of the logs' mean air flow.",
        default=0.1,
    ),
    as_json: bool = JSON,
) -> None:
    """Write the map for calibration tools, or the observer for a control unit. With --old, list the changes against an old DCM.

    Example: lpvobs export nedc.h5 --format dcm --out maf.dcm --only-estimated --old ecu.dcm --name delta_W_c;
    lpvobs export gain.h5 nedc.h5 --format c99 --out unit
    """
    from lpvobs.api.export import export as export_map
    from lpvobs.api.export_unit import FORMATS as OBSERVERS
    from lpvobs.api.export_unit import ExportOutput, export_unit
    from lpvobs.report.tables import change_rows, grams, origin_counts

    file_format = file_format.lower()
    said = partial(ExportOutput, out=str(out), format=file_format)
    if file_format in OBSERVERS:
        made = export_unit(result, out, file_format, result=start, engine=engine, map_gain=map_gain, rate=rate)
        if as_json:
            print_json("export", said(values=made.start, digits=17, nodes={}, changes=None, widest=None, unit=made))
            return
        for number, size in made.bytes_of_state.items():
            pivot = made.smallest_pivot[number]
            print(
                f"{number}: state {size} bytes; Theorem 1 proven again for the rounded gain, smallest pivot {pivot:.3g}"
            )
        say(
            f"{out}: the observer with {made.map_gain} map gain; its output lags by {made.delay:g} s and up to two samples"
        )
        return
    if start is not None or engine is not None or map_gain:
        raise UsageError(
            f"--format {file_format}: expected one result alone; drop the second result, --engine and --map-gain, which only "
            f"{' and '.join(OBSERVERS)} take"
        )

    done = export_map(
        result, out, file_format, values=source, only_estimated=only_estimated, old=old, name=name, kind=kind, digits=digits,
        widest=widest, unit=unit, a2l=a2l,
    )  # fmt: skip
    counts = origin_counts(done.surface)
    if as_json:
        where, changed = done.surface.source, done.changes
        told = said(values=where, digits=digits, nodes=counts, changes=changed, widest=done.widest, unit=None)
        print_json("export", told)
        return
    if done.changes:
        print(table(*change_rows(done.surface, done.changes)))
    if done.changes is not None:
        say(f"{len(done.changes)} of {done.surface.origin.size} nodes differ from {old}")
    if file_format == "lab":
        say(f"{out}: a list of the label {name} and the channels that a log needs")
        return
    say(f"{out}: {', '.join(f'{count} {origin}' for origin, count in counts.items())}")
    if left := counts.get("left_out", 0):
        say(
            f"{left} nodes left out, because their 90 % interval is wider than +-{grams(done.widest)} g/s; --widest sets this limit"
        )
    if done.limited:
        say(f"{done.limited} values were clipped to the limits of the control unit")
