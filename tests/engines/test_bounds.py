"""What a constant can be: every constant says it, and what is outside is refused with what was probably meant."""

from dataclasses import is_dataclass
from typing import get_type_hints

import pytest
from repository import CONFIGS

from lpvobs.engines.constants import USUAL_UNITS, Within
from lpvobs.engines.registry import ENGINES
from lpvobs.errors import UsageError
from lpvobs.io.configuration.config import load_config


def constants(record, where=""):
    """Yield place and bounds of every constant of a record."""
    for name, hint in get_type_hints(record, include_extras=True).items():
        if is_dataclass(hint):
            yield from constants(hint, f"{where}{name}.")
        elif hint is not str:  # the name of a form
            yield f"{where}{name}", [item for item in getattr(hint, "__metadata__", ()) if isinstance(item, Within)]


@pytest.mark.parametrize("kind", ENGINES.values(), ids=list(ENGINES))
def test_every_constant_of_every_engine_has_bounds(kind):
    found = dict(constants(kind.tables["engine"]))
    assert len(found) > 10
    assert [name for name, bounds in found.items() if len(bounds) != 1] == []
    assert all(bounds.low < bounds.high and bounds.what for (bounds,) in found.values())


@pytest.mark.parametrize(
    ("old", "new", "meant"),
    [
        (
            "V_d = 1.910e-3",
            "V_d = 1.9",
            "1.9 m^3 is not a plausible displacement, expected 0.0001 to 0.2; did you mean 0.0019 (1.9 litres)?",
        ),
        ("V_d = 1.910e-3", "V_d = 1910.0", "did you mean 0.00191 (1910 cm^3)?"),
        ("R_c = 0.0245", "R_c = 24.5", "did you mean 0.0245 (24.5 mm) or 0.245 (24.5 cm)?"),
        ("eta_c_max = 0.72", "eta_c_max = 72.0", "did you mean 0.72 (72 %)?"),
        ("W_c_opt = 0.085", "W_c_opt = 306.0", "did you mean 0.306 (306 g/s) or 0.085 (306 kg/h)?"),
        ("c_vol3 = 1.005", "c_vol3 = 1005.0", "did you mean 1.005?"),
        ("J_t = 1.6e-5", "J_t = -16.0", "correct that key"),
        ("Q = [32.0, -8.0, 2.15]", "Q = [32.0, -8.0, nan]", "engine.compressor.Q = nan"),
    ],
)  # fmt: skip
def test_a_value_outside_is_refused_with_what_was_probably_meant(tmp_path, old, new, meant):
    text = (CONFIGS / "diesel.toml").read_text(encoding="utf-8")
    assert text.count(f"\n{old}") == 1
    path = tmp_path / "mine.toml"
    path.write_text(text.replace(f"\n{old}", f"\n{new}"), encoding="utf-8")
    with pytest.raises(UsageError) as failure:
        load_config(path)
    assert f"{path}: engine." in str(failure.value)
    assert meant in str(failure.value)


def test_the_likeliest_unit_is_offered_first_and_the_nearest_power_of_ten_last():
    size = Within(0.01, 0.02, "m", "size")
    assert "(15 mm)" in size.complaint(15.0)
    assert "(1.5 cm)" in size.complaint(1.5)
    assert "did you mean 0.012?" in Within(0.01, 0.02, "rad", "angle").complaint(1.2)
    assert size.complaint(0.01) is size.complaint(0.02) is None
    assert all(factor > 0 for units in USUAL_UNITS.values() for _, factor in units)
