"""How recordings of other programs call the channels of a throttled engine; the opening of the wastegate is worth keeping."""

from collections.abc import Mapping

from lpvobs.engines.channels import PRESSURE, SHARE, TEMPERATURE, Recorded

RECORDED: Mapping[str, Recorded] = {
    "m_f": Recorded("1", (1e-6, 1e3), ("1",), "", "", r"m f|fuel (mass )?per stroke", r"injected fuel mass|fuel mass"),
    "alpha_th": Recorded(
        "%",
        (0, 100),
        SHARE,
        "throttle position, throttle valve position, throttle",
        "throttle -pressure -temp -before",
        r"alpha th",
        r"alpha",
    ),
    "u_wg": Recorded("1", (-0.05, 1.05), SHARE, "wastegate position", "wastegate", r"u wg"),
    "p_ic": Recorded(
        "Pa",
        (6e4, 4e5),
        PRESSURE,
        "intercooler pressure, throttle before pressure",
        "boost pressure, intercooler pressure",
        r"p ic",
        r"put",
    ),
    "T_ic": Recorded(
        "K",
        (230, 420),
        TEMPERATURE,
        "",
        "intake air temp -manifold, boost temp -manifold, intercooler temp",
        r"t ic|intercooler temp(erature)?",
    ),
}
