"""Names from other people's files, drawn."""

import pytest

from lpvobs.discovery.outcome import Ranked
from lpvobs.report.residual_figures import ranking_bars
from lpvobs.report.svg import drawn, label_of

NAMES = ("a $x_{$ b", r"$\frac{1}{$", "<script>alert(1)</script>", "two\nlines", "进气压力", "W" * 300, "_under")


@pytest.mark.parametrize("name", NAMES)
def test_any_name_of_a_channel_can_be_drawn(name):
    """Warnings are errors here: neither a formula in the name, nor a letter without a glyph, nor a long name spoils a figure."""
    drawn = ranking_bars("r", f"ranking with {name}", [Ranked(name, 1.0, "1", 10.0, 1.0)])
    assert drawn.startswith("<svg")
    assert "<script>" not in drawn


def test_a_short_name_stays():
    assert label_of("channel:T_coolant") == "channel:T_coolant"


def test_a_long_name_keeps_both_ends():
    name = "begin" + "x" * 100 + "finis"
    assert label_of(name).startswith("beginx")
    assert label_of(name).endswith("xfinis")


@drawn()
def decades(figure, low, high):
    figure.add_subplot().loglog([low, high], [low, high])


@pytest.mark.parametrize(("low", "high", "labels"), [(1e-5, 1e3, ["10⁻⁵", "1000"]), (0.2, 0.9, ["0.2", "0.6"])])
def test_a_logarithmic_axis_has_no_formulas(low, high, labels):
    text = decades("d", "some decades", low, high)
    assert "$" not in text
    assert "mathdefault" not in text
    assert all(f">{label}<" in text for label in labels)
