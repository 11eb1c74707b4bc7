"""How recordings of other programs call the channels of a diesel."""

from collections.abc import Mapping

from lpvobs.engines.channels import SHARE, SPEED, Recorded
from lpvobs.engines.components.recorded import SHARED

RECORDED: Mapping[str, Recorded] = {
    **SHARED,
    "u_vgt": Recorded(
        "%",
        (-5, 105),
        SHARE,
        "vgt position, vgt actuator, vgt actual, vgt actuator position, turbo position actual, turbo boost position actual",
        "vgt -temp -pressure -speed, turbo position, boost position, turbo actuator, boost actuator, turbo valve",
        r"u ?vgt|(eng(ine)? )?turbo vane ?1? position",
        r"ladedruck(steller|regel).*",
    ),
    "omega_t": Recorded(
        "rad/s",
        (300, 3e4),
        SPEED,
        "turbo speed, turbo boost speed, turbo revs, turbo boost revs, boost speed",
        "turbo speed, turbo revs, turbine speed, turbine revs, boost speed, boost revs, compressor speed, compressor revs",
        r"omega t|nt",
        r"n ?t(urb.*)?",
    ),
}
