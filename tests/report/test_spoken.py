"""Effects in a sentence: what a person would say of each, with the size in the words' own unit."""

import pytest

from lpvobs.engines.diesel.effects import CATALOGUE
from lpvobs.report.spoken import in_words


def effect(name, parameter, value, low, high, unit="1", **more):
    sizes = {parameter: {"value": value, "unit": unit, "ci90": [low, high]}}
    return {"id": name, "parameters": sizes, "onset": None, "end": None, "indistinguishable": []} | more


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (
            effect("maf.gain", "factor", 1.0965, 1.0951, 1.0979, onset=122.0),
            "the MAF reads 9.65 % high (90 %: 9.51 to 9.79) from 122.0 s",
        ),
        (effect("T_x.gain", "factor", 0.8, 0.785, 0.815), "T_x reads 20.0 % low (90 %: 18.5 to 21.5)"),
        (effect("maf.offset", "offset", -5e-4, -6.2e-4, -3.8e-4, "kg/s"), "the MAF reads 0.50 g/s too little (90 %: 0.38 to 0.62)"),
        (effect("leak.intake", "area", 2e-5, 1.88e-5, 2.12e-5, "m^2"), "the intake leaks through 20.0 mm^2 (90 %: 18.8 to 21.2)"),
        (
            effect("eta_vol.factor", "factor", 0.95, 0.935, 0.965, onset=1.0, end=2.0),
            "eta_vol is 5.0 % lower (90 %: 3.5 to 6.5) from 1.0 s to 2.0 s",
        ),
        (
            effect("maf.backflow", "coefficient", 0.2, 0.07, 0.33, indistinguishable=["a", "b"]),
            "effect maf.backflow acts with coefficient = 0.20 (90 %: 0.07 to 0.33) (a, b explain this as well)",
        ),
        (
            effect("channel:heat", "amplitude", 1.0, 0.9, 1.1, curve={"changes": "maf.gain"}),
            "maf.gain changes with the logged channel heat",
        ),
    ],
)  # fmt: skip
def test_an_effect_is_said_as_a_person_would_say_it(found, said):
    assert in_words([found]) == said
    assert in_words([found, found]) == f"{said}; {said}"


@pytest.mark.parametrize("entry", CATALOGUE, ids=lambda entry: entry.id)
def test_words_agree_with_the_catalogue_on_what_no_effect_is(entry):
    """Twice the noticeable size, and as much the other way: the same number in both sentences, in other words."""
    said = [
        in_words(
            [effect(entry.id, entry.parameter, entry.null + x, entry.null + x - h, entry.null + x + h, entry.unit)]
        )
        for h in (0.13 * entry.size,)
        for x in (2.0 * entry.size, -2.0 * entry.size)
    ]
    if " acts with " not in said[0]:
        numbers = [[word for word in text.split() if word[0].isdigit()] for text in said]
        assert numbers[0] == numbers[1]
        assert said[0] != said[1]
