"""`lpvobs verify`."""

from pathlib import Path

from lpvobs.cli.common import guarded, print_json, table
from lpvobs.cli.options import JSON, argument, option


@guarded
def verify(
    gain: Path = argument("GAIN.h5", "A gain made by synth-gain."),
    config: Path | None = option("TOML", "The configuration whose engine the gain has to be for.", "--config"),
    as_json: bool = JSON,
) -> None:
    """Prove the certificate of a gain again, in exact arithmetic and without the solver.

    Exit code 1 if the stored numbers do not prove Theorem 1 on the stored region, 3 if the gain is not for the engine of --config.

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
        print(f"{gain}: Theorem 1 proven at all {certificate.vertices} vertices of the region")
        print(f"smallest relative pivot {certificate.smallest_pivot:.3g}; region: {stored.gain.region}")
        print(f"made for {stored.made_for()}")
        if stored.gain.bound is not None:
            print("the error of the state is bounded, also proven:")
            print(table(*state_bound_table(stored)))
