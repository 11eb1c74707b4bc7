"""The object of `report --json`, made of results and the logs that were given."""

from typing import Any

import numpy as np

from lpvobs.report import outputs
from lpvobs.report.content import Report, ResultView
from lpvobs.report.discovered import GROUPS
from lpvobs.report.fit import ResidualFit
from lpvobs.report.names import paper_error


def report_output(report: Report) -> outputs.ReportOutput:
    """Return the object of `report --json`."""
    results = [_result_output(view) for view in report.results]
    best = {(fit.result, fit.log): fit for fit in report.best_fits}
    logs = [
        outputs.ReportedLog(
            result=name,
            method=result.method,
            paper_mean_relative_error=paper_error(result.air_path, log.name),
            **_fit_fields(best.get((name, log.name))),
            **outputs.log_fields(log),
        )
        for name, result in report.named
        for log in result.logs
    ]
    return outputs.ReportOutput(
        logs=logs,
        map=results[0].map,
        extrapolation=results[0].extrapolation,
        results=results,
        regions=report.regions,
        fits=report.fits,
        refused=[f"{name}: {line}" for name, result in report.named for line in result.refused],
    )


def _fit_fields(best: ResidualFit | None) -> dict[str, Any]:
    if best is None:
        return dict.fromkeys(("fit", "lags_outside", "input_lags_outside"))
    outside = max(best.outside.values(), default=0.0)
    return {"fit": best.fit, "lags_outside": best.lags_outside, "input_lags_outside": outside}


def _result_output(view: ResultView) -> outputs.ReportedResult:
    result, found = view.stored, {GROUPS[item.verb]: item.content for item in view.discovered}
    fitted, nodes = result.extrapolation, int(result.supported.sum())
    errors = result.standard_error[result.supported]
    sought = found.get("trace") or found.get("refinement") or {"verdict": None, "error": {}}
    return outputs.ReportedResult(
        result=view.name,
        file=str(result.path),
        method=result.method,
        map=outputs.MapCounts(
            cells=result.grid.size,
            estimated=nodes,
            extrapolated=0 if fitted is None else int((fitted.support == 2).sum()),
        ),
        nodes_estimated=nodes,
        standard_error=float(np.median(errors)) if errors.size and (errors > 0.0).all() else None,
        balance_agreement=result.balance_agreement,
        verdict=sought["verdict"],
        residual=sought["error"].get("after", sought["error"].get("before")),
        extrapolation=None if fitted is None else outputs.QuadraticOutput(**outputs.quadratic_fields(fitted)),
        gain=outputs.ReportedGain(
            **outputs.gain_fields(result.gain), smallest_pivot=result.gain.gain.certificate.smallest_pivot
        ),
        **found,
    )
