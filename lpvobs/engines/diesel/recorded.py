"""How recordings of other programs call the channels of a diesel."""

from collections.abc import Mapping

from lpvobs.engines.channels import SHARE, SPEED, Recorded
from lpvobs.engines.components.recorded import SHARED

RECORDED: Mapping[str, Recorded] = {
    **SHARED,
    "u_vgt": Recorded(
        "%", (-5, 105), SHARE, r"u vgt|(vgt|vtg|vnt) (pos|position|opening)", r".*\b(vgt|vtg|vnt|vane)\b.*"
    ),
    "omega_t": Recorded(
        "rad/s",
        (300, 3e4),
        SPEED,
        r"omega t|turb(o|ine) speed|n (turb|tc)",
        r".*(turbo|turbine|charger).*(speed|rpm).*",
    ),
}
