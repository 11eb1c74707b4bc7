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
        r"(exhaust )?lambda( e| exhaust| ist| act)?|lamsoni?( w)?|"
        r"o2 sensor ?1? (wide range )?(equivalence ratio|lambda)|"
        r"lambda sensor",
        r".*(lambda|\blam\b|\bafr\b|equivalence|air fuel).*",
        r"(LSU|Lsu|LamSnsr|LamS|O2S)\w*_(rLam|lam)\w*",
    ),
}
