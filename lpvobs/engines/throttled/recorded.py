"""How recordings of other programs call the channels of a throttled engine; the opening of the wastegate is worth keeping."""

from collections.abc import Mapping

from lpvobs.engines.channels import PRESSURE, SHARE, TEMPERATURE, Recorded

RECORDED: Mapping[str, Recorded] = {
    "m_f": Recorded("1", (1e-6, 1e3), ("1",), r"m f|fuel (mass )?per stroke", r"injected fuel mass|fuel mass"),
    "alpha_th": Recorded(
        "%",
        (0, 100),
        SHARE,
        r"alpha th|(absolute )?throttle (valve )?(pos|position|opening)|drosselklappe",
        r".*\b(throttle|tps|alpha)\b.*",
    ),
    "u_wg": Recorded("1", (-0.05, 1.05), SHARE, r"u wg|waste ?gate (pos|position|opening)", r".*waste ?gate.*"),
    "p_ic": Recorded(
        "Pa",
        (6e4, 4e5),
        PRESSURE,
        r"p ic|intercooler press(ure)?|press(ure)? before throttle",
        r"boost pressure|ladedruck|charge pressure",
    ),
    "T_ic": Recorded(
        "K",
        (230, 420),
        TEMPERATURE,
        r"t ic|intercooler temp(erature)?",
        r"intake air temp(erature)?|iat|charge air temp(erature)?",
    ),
}
