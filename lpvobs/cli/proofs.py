"""What is proven: the observer gain by `lpvobs synth-gain` and `lpvobs verify`, the installation by `lpvobs selftest`."""

from pathlib import Path

import typer

import lpvobs
from lpvobs.cli.common import chosen_config, print_json, progress, say, table
from lpvobs.cli.options import CONFIG, JSON, argument, needed, option


def synth_gain(
    out: Path = needed("GAIN.h5", "The gain file to write."),
    logs: list[Path] | None = argument(
        "[LOG]...", "Logs, patterns or folders. The gain is proven for the parameter ranges that these logs cover."
    ),
    published: str | None = option(
        "COLUMN",
        "Store the gain L that the paper prints in Eq. (38), proven for this column of the paper's Table 1: ETC, FTP75 or NEDC.",
    ),
    config: Path | None = CONFIG,
    as_json: bool = JSON,
) -> None:
    """Compute the observer gain and prove that the observer is stable with it.

    The gain L comes from the linear matrix inequalities of the paper's Theorem 1. The proof is in exact arithmetic. The ranges of
    the scheduling parameters rho come from the logs, or from [gain.bounds] of the configuration. The ranges of the temperatures
    come from [gain.temperatures].

    Example: lpvobs synth-gain --config configs/diesel.toml etc.parquet ftp75.parquet nedc.parquet --out gain.h5
    """
    from lpvobs.api.synth_gain import SynthGainOutput
    from lpvobs.report.outputs import gain_fields
    from lpvobs.report.tables import bounds_table, state_bound_table

    config = chosen_config(config)
    with progress("synthesising") as report:
        stored = lpvobs.synth_gain(config, logs or (), out=out, published=published)
        report(1.0)
    gain = stored.gain
    if as_json:
        region = gain.region
        ranges = {n: (a, b) for n, a, b in zip(region.names, region.lower, region.upper, strict=True)}
        made = SynthGainOutput(
            gain=str(out),
            **gain_fields(stored),
            eps_1=gain.eps_1,
            eps_2=gain.eps_2,
            region=ranges,
            nonnegative_sums=region.nonnegative_sums,
            logs={log: tuple(bounds.tolist()) for log, bounds in stored.log_bounds.items()},
        )
        print_json("synth-gain", made)
        return
    vertices = gain.certificate.vertices
    print(f"observer gain L ({stored.origin}); stability proven at all {vertices} vertices of the parameter region")
    rows = [[state, *(f"{value:.6g}" for value in row)] for state, row in zip(stored.states, gain.L, strict=True)]
    print(table(["", *stored.outputs, "sensor"], rows))
    print("\n" + table(*bounds_table(stored)))
    if gain.bound is not None:
        print("\nproven bounds of the observer's state error:\n" + table(*state_bound_table(stored)))


def verify(
    gain: Path = argument("GAIN.h5", "An observer gain made by synth-gain."),
    config: Path | None = option(
        "TOML", "A configuration file. verify then also checks that the gain was made for the engine in it."
    ),
    as_json: bool = JSON,
) -> None:
    """Prove the stability of a stored observer gain again, without the solver. The proof is in exact arithmetic.

    Exit code 1 if the stored numbers do not prove Theorem 1 on the stored parameter region, 3 if the gain was made for another
    engine than that in --config.

    Example: lpvobs verify gain.h5 --config configs/diesel.toml
    """
    from lpvobs.api.verify import VerifyOutput, check_stored, expect_proven
    from lpvobs.report.outputs import state_bound_output
    from lpvobs.report.tables import state_bound_table

    stored, certificate = check_stored(gain, config)
    if as_json:
        proof = VerifyOutput(
            gain=str(gain),
            region=str(stored.gain.region),
            made_for=stored.made_for(),
            state_bound=state_bound_output(stored),
            **vars(certificate),
        )
        print_json("verify", proof)
    expect_proven(gain, certificate)
    if not as_json:
        print(f"{gain}: Theorem 1 proven at all {certificate.vertices} vertices of the parameter region")
        print(f"smallest relative pivot {certificate.smallest_pivot:.3g}; region: {stored.gain.region}")
        print(f"gain made for {stored.made_for()}")
        if stored.gain.bound is not None:
            print("proven bounds of the observer's state error:\n" + table(*state_bound_table(stored)))


def selftest(as_json: bool = JSON) -> None:
    """Test the installed package on cases with known answers. It is for users who must qualify their tools.

    The command needs no files and leaves none. Exit code 1 if an answer is wrong.

    Example: lpvobs selftest
    """
    from lpvobs.errors import NotProven
    from lpvobs.selftest.cases import SelftestOutput, run_cases

    with progress("testing") as report:
        rows, versions = run_cases(report)
    failed = [row for row in rows if not row.passed]
    if as_json:
        print_json("selftest", SelftestOutput(passed=not failed, cases=rows, versions=versions))
    else:
        lines = []
        for row in rows:
            numbers = [f"{number:.6g}" for number in (row.expected, row.found, row.tolerance)]
            lines.append([row.case, *numbers, row.unit, "pass" if row.passed else "FAIL"])
        print(table(["case", "expected", "found", "tolerance", "unit", ""], lines))
        say(", ".join(f"{name} {number}" for name, number in versions.items()))
        for row in failed:
            say(f"{row.case}: {row.note or 'the answer is wrong'}")
        say(f"{len(rows) - len(failed)} of {len(rows)} cases passed")
    if failed:
        raise typer.Exit(NotProven.exit_code)
