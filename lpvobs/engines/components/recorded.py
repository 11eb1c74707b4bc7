"""How recordings of other programs call the channels of engines with exhaust gas recirculation."""

from collections.abc import Mapping

from lpvobs.engines.channels import PRESSURE, SHARE, TEMPERATURE, Recorded

SHARED: Mapping[str, Recorded] = {
    "u_delta": Recorded(
        "mg/cycle",
        (1, 120),
        ("mg/cycle",),
        r"u ?delta|fuel stroke|d.bit (d )?injection|einspritzmenge( (ist|ges|gesamt|aktuell))?|inj(ection|"
        r"ected)? (fuel )?(qnt|qty|quantity)|mrm (eakt|emot)|"
        r"(total |injected |actual )?fuel (inj(ection)? )?(qnt|qty|quantity)( .*)?|cyl(inder)? fuel rate",
        r".*(fuel|inj|carburant|kraftstoff|einspritz).*",
        r"InjSys_q(Tot|Act)?(_mp|_r32)?|InjCtl_qSetUnBal|InjCrv_qTot\w*",
    ),
    "u_egr": Recorded(
        "%",
        (-5, 105),
        SHARE,
        r"u ?egr|(egr|agr) lift act|(eng(ine)? )?exhaust gas recirculation valve ?1? pos(ition)?|(egr|"
        r"agr) istwert|(eng(ine)? )?(egr|agr) ?1? ?(valve ?1?|ventil)? ?(act(ual)? )?(pos(ition)?|opening|lift|"
        r"stellung|öffnung|oeffnung|hub)"
        r"( (ist|act(ual)?|feedback))?|actual egr( duty cycle)?",
        r".*\b(egr|agr)\b.*|.*recirculation.*|.*(agr|egr).*(ventil|valve|rate).*|.*abgasrück.*",
        r"EGRVlv(HP)?_r(Act|ActFlt)?(_mp|_r32)?|(EGR|AGR)\w*_r(Act|Flt)\w*",
    ),
    "p_em": Recorded(
        "Pa",
        (6e4, 6e5),
        PRESSURE,
        r"p ?em|p exhaust manifold|p abgas v(or)? t(urbine)?|"
        r"(eng(ine)? )?exhaust mani(fold)? (absolute )?press(ure)?|press(ure)? before turbine|"
        r"(abgas)?druck vor (der )?turbine",
        r"p ?(3|31|exh).*|.*exhaust.*press.*|.*abgas.*druck.*",
        r"Exh_p(TrbnUs|ExhMnf|Mnf)\w*|(ExhMnf|PExhMnf|TrbnUs)\w*_p\w*",
    ),
    "T_im": Recorded(
        "K",
        (230, 420),
        TEMPERATURE,
        r"t ?im|t intake manifold|t lade|thim|mct|(eng(ine)? )?(intake|"
        r"inlet) mani(fold)? ?1? ?(air )?temp(erature)?|(saugrohr|"
        r"ladeluft)temp(eratur)?|tans( w)?",
        r"t ?(2|22|int).*|iatscd.*|.*temp.rature.*admission.*|iat|intake air temp(erature)?|(charge|"
        r"boost) air.*temp.*|.*ansaug.*temp.*|.*(manifold|"
        r"ladeluft).*temp.*",
        r"Air_t(CACDs|IntkV|IntkMnf|IntMnf)\w*|(IntMnf|IntkMnf|IntkVT|CACDsT)\w*_t(?!i)\w*",
    ),
    "T_em": Recorded(
        "K",
        (300, 1300),
        TEMPERATURE,
        r"t ?em|t exhaust manifold|t abgas v(or)? t(urbine)?|exhaust manifold temp(erature)?|"
        r"(exhaust )?(gas )?temp(erature)? before turbine|abgastemp(eratur)? vor "
        r"(turbine|turbo(lader)?)",
        r"t ?(3|31|exh).*|egt.*|.*exh(aust)?.*temp.*|.*abgas.*temp.*|.*exh gas temp.*",
        r"Exh_t(TrbnUs|ExhMnf|Mnf)\w*|(ExhMnf|TrbnUs)\w*_t(?!i)\w*",
    ),
}
