"""How recordings of other programs call the channels that series vehicles log."""

from collections.abc import Mapping

from lpvobs.engines.channels import Recorded
from lpvobs.engines.components.recorded import SHARED

RECORDED: Mapping[str, Recorded] = {
    **SHARED,
    "lambda_e": Recorded(
        "1",
        (0.8, 12),
        ("1",),
        "lambda, lambda sensor, lambda exhaust, lambda position, lambda sensor position, oxygen lambda, oxygen lambda ratio",
        "lambda, oxygen -mass, afr, fuel air ratio",
    ),
}
