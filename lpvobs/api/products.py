"""What a result is made into for others: calibration files, reports, gates."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from lpvobs.api.files import File, as_path, as_paths, writing

if TYPE_CHECKING:
    from lpvobs.api.export import Exported


def export(
    result: File,
    out: File,
    file_format: str,
    *,
    values: str = "",
    only_estimated: bool = False,
    old: File | None = None,
    name: str = "delta_W_c",
    kind: str = "",
    digits: int = 7,
) -> "Exported":
    """Write the map for calibration tools: what to subtract from a reading.

    Parameters
    ----------
    result : path
    out : path
        The file to write.
    file_format : str
        `dcm`, `csv` or `netcdf`.
    values : str
        `map` or `extrapolation`; by default the latter if there is one.
    only_estimated : bool
        No extrapolated node: the old value there, or nothing.
    old : path, optional
        A DCM with the map as it was: its axes, units and kind stay.
    name : str
        Label of the map.
    kind : str
        `KENNFELD` or `GRUPPENKENNFELD`; by default the old map's, else the former.
    digits : int
        Significant digits in DCM and CSV.

    Returns
    -------
    Exported
        `surface` with values of shape (p2, p1) in the unit it names, `changes` against the old map.

    Raises
    ------
    UsageError
        If the request contradicts itself.
    DataError
        If the result or the old file cannot be used, or a DCM would have empty nodes.
    """
    from lpvobs.api.export import Request, export_result

    before = None if old is None else as_path(old)
    request = Request(file_format, values, only_estimated, before, name, kind.upper(), digits)
    with writing(as_path(out), [as_path(result), *([before] if before else [])]) as target:
        return export_result(as_path(result), target, request)


def write_report(
    result: File, further: File | Iterable[File] = (), *, html: File | None = None, gates: Sequence[str] = ()
) -> dict[str, Any]:
    """Return how far the corrected sensor is from the truth, write the page if asked for, and judge the gates.

    Parameters
    ----------
    result : path
    further : path or several
        Logs that the results were made from (time series), and further results.
    html : path, optional
        The self-contained page to write.
    gates : sequence of str
        Such as `mean_relative_error<=0.02`; fractions are fractions.

    Returns
    -------
    dict
        The object that `lpvobs report --json` prints, without its schema: flows in kg/s.

    Raises
    ------
    NotProven
        If a log fails a gate; the page is written all the same.
    DataError
        If a file cannot be used, or a log lacks the metric of a gate.
    UsageError
        If a gate cannot be understood.
    """
    from lpvobs.report.content import gather
    from lpvobs.report.discovered import contents
    from lpvobs.report.gates import enforce, judge, parse_gate
    from lpvobs.report.load import load
    from lpvobs.report.names import distinct
    from lpvobs.report.page import write_page
    from lpvobs.report.tables import report_content

    conditions = [parse_gate(expression) for expression in gates]
    paths = [as_path(result), *as_paths(further)]
    loaded = load(paths)
    names = distinct([item.path for item in loaded.results])
    content = report_content(list(zip(names, loaded.results, strict=True)))
    for item, found in zip(content["results"], loaded.discovered, strict=True):
        item.update(contents(found))
    if html is not None:
        with writing(as_path(html), paths) as target:
            write_page(target, gather(loaded))
    enforce(judge(conditions, content["logs"]))
    return content
