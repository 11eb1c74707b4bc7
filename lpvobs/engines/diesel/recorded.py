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
        r"u ?vgt|(eng(ine)? )?(vgt|vtg|vnt|turbo vane) ?1? ?(act(uator|ual)? ?1? )?(pos(ition)?|opening|"
        r"stellung)( ist)?",
        r".*\b(vgt|vtg|vnt|vane)\b.*|.*ladedruck(steller|regel).*|.*variable geometry.*",
        r"(TrbCh|TrbChrg|VGT|VTG|TrbVtg)\w*_r(Act|ActFlt)?(_mp|_r32)?",
    ),
    "omega_t": Recorded(
        "rad/s",
        (300, 3e4),
        SPEED,
        r"omega t|nt|n turbo|n atl|(eng(ine)? )?turb(o|ine|ocharger|o charger) ?1? ?(speed|rpm)|n (turb|tc)|"
        r"(turbolader|turbinen|"
        r"lader)drehzahl",
        r".*(turbo|turbine|charger|lader).*(speed|rpm|drehzahl).*",
        r"(TrbChrg|TrbCh|Trbn|Trb|TCSpd)\w*_n\w*",
    ),
}
