"""How recordings of other programs call the channels of engines with exhaust gas recirculation."""

from collections.abc import Mapping

from lpvobs.engines.channels import PRESSURE, SHARE, TEMPERATURE, Recorded

SHARED: Mapping[str, Recorded] = {
    "u_delta": Recorded(
        "mg/cycle",
        (1, 120),
        ("mg/cycle",),
        r"u delta|einspritzmenge|inj(ection|ected)? (qnt|quantity)|fuel (qnt|quantity)( .*)?",
        r".*(fuel|inj).*",
    ),
    "u_egr": Recorded("%", (-5, 105), SHARE, r"u egr|(egr|agr) (valve )?(pos|position|opening)", r".*\b(egr|agr)\b.*"),
    "p_em": Recorded(
        "Pa",
        (6e4, 6e5),
        PRESSURE,
        r"p em|exhaust manifold (absolute )?press(ure)?",
        r"p ?(3|31|exh).*|.*exhaust.*press.*",
    ),
    "T_im": Recorded(
        "K",
        (230, 420),
        TEMPERATURE,
        r"t im|intake manifold (air )?temp(erature)?",
        r"t ?(2|22|int).*|iat|intake air temp(erature)?",
    ),
    "T_em": Recorded(
        "K", (300, 1300), TEMPERATURE, r"t em|exhaust manifold temp(erature)?", r"t ?(3|31|exh).*|egt|.*exhaust.*temp.*"
    ),
}
