"""`lpvobs verify`."""

from pathlib import Path
from typing import Annotated

from lpvobs.cli.common import guarded, print_json
from lpvobs.cli.options import JsonOption, file_argument


@guarded
def verify(
    gain: Annotated[Path, file_argument("GAIN.h5", "A gain made by synth-gain.")],
    as_json: JsonOption = False,
) -> None:
    """Prove the certificate of a gain again, in exact arithmetic and without the solver.

    Exit code 1 if the stored numbers do not prove Theorem 1 on the stored region.

    Example: lpvobs verify gain.h5
    """
    from lpvobs.api.verify import VerifyOutput, check_stored, expect_proven

    stored, certificate = check_stored(gain)
    if as_json:
        proof = VerifyOutput(gain=str(gain), region=str(stored.gain.region), **vars(certificate))
        print_json("verify", proof)
    expect_proven(gain, certificate)
    if not as_json:
        more = "; also for map gains that fall with information" if certificate.falling_gain else ""
        print(f"{gain}: Theorem 1 proven at all {certificate.vertices} vertices of the region{more}")
        print(f"smallest relative pivot {certificate.smallest_pivot:.3g}; region: {stored.gain.region}")
