"""How recordings of other programs call the channels of engines with exhaust gas recirculation."""

from collections.abc import Mapping

from lpvobs.engines.channels import PRESSURE, SHARE, TEMPERATURE, Recorded

SHARED: Mapping[str, Recorded] = {
    "u_delta": Recorded(
        "mg/cycle",
        (1, 120),
        ("mg/cycle",),
        "fuel quantity, injection quantity, fuel injection quantity, fuel quantity total, injection quantity total, "
        "fuel injection quantity total, fuel stroke, injection stroke, fuel quantity stroke, injection quantity stroke",
        "fuel -speed -revs, injection -speed -revs, quantity -air",
        r"u ?delta|d.bit (d )?injection|mrm (eakt|emot)|cyl(inder)? fuel rate|inj ctl q set un bal|inj crv q tot",
        r"m[fbk]|me|mf? ?(tot|fuel|f|e|inj|einspr).*|q ?(f|e|inj|tot|act|fuel|einspr).*|mr[mo].*|total fuelling",
    ),
    "u_egr": Recorded(
        "%",
        (-5, 105),
        SHARE,
        "egr position, egr valve position, egr valve, egr actual, egr actuator position, egr valve actuator position",
        "egr -temp -pressure -mass -speed, egr mass position",
        r"u ?egr|(egr|agr) istwert|actual egr( duty cycle)?",
        r"ehm f?ars?|.*(egr|agr)(pos|act|r)?",
    ),
    "p_em": Recorded(
        "Pa",
        (6e4, 6e5),
        PRESSURE,
        "exhaust manifold pressure, exhaust turbine before pressure, turbine before pressure, exhaust turbo before pressure, "
        "turbine intake pressure",
        "exhaust pressure -after, turbine pressure -after, turbo before pressure",
        r"p ?em|p abgas v t",
        r"tip|p ?(3|31|exh|ex|abg).*",
    ),
    "T_im": Recorded(
        "K",
        (230, 420),
        TEMPERATURE,
        "intake manifold temp, manifold temp, boost temp manifold, intercooler after temp, intake valve before temp",
        "intake temp -turbine -exhaust -compressor, manifold temp -exhaust, boost temp -turbine, intercooler temp, "
        "turbo temp -exhaust -turbine, air temp -ambient -exhaust",
        r"t ?im|t lade|thim|tans( w)?|ladelufttemp(eratur)?( (ist|sensor))?",
        r"t ?(2|22|2s|int|man).*|iatscd.*|anm ?ltf|thia?|cat|act|ait|llt|t ?[ls]|air temp(erature)?|lufttemperatur",
    ),
    "T_em": Recorded(
        "K",
        (300, 1300),
        TEMPERATURE,
        "exhaust manifold temp, exhaust turbine before temp, turbine before temp, exhaust turbo before temp, "
        "turbine intake temp, turbo turbine intake temp, exhaust turbine intake temp",
        "exhaust temp -after, turbine temp -after, turbo before temp",
        r"t ?em|t abgas v t",
        r"tit|t ?(3|31|exh|ex|abg).*",
    ),
}
