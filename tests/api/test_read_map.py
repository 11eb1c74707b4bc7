"""A map for notebooks: as a figure, for pandas and xarray, and what it says of itself."""

import matplotlib as mpl
import numpy as np
import pytest

import lpvobs as package
from lpvobs.errors import DataError
from lpvobs.io.results.surfaces import ORIGINS


@pytest.fixture(scope="module")
def surface(chain):
    return package.read_map(chain.result)


def test_it_says_what_it_is(surface):
    said = repr(surface)
    assert said.startswith("Map of the sensor error [kg/s], u_delta [mg/cycle] over n_e [rpm]: ")
    assert "the sensor reads" in said
    assert len(said) < 500
    assert repr(surface.difference(surface)).startswith("Map of")


def test_a_notebook_shows_a_figure(surface):
    html = surface._repr_html_()
    assert html.count("<svg") == 1
    assert "g/s on average" in html
    assert "<script" not in html


def test_pandas_has_a_row_per_node(surface):
    rows = surface.to_pandas()
    assert list(rows) == ["n_e", "u_delta", "delta_W_c", "standard_error", "origin"]
    assert len(rows) == surface.values.size
    row = rows[(rows.n_e == 1500.0) & (rows.u_delta == 8.0)].iloc[0]
    place = np.flatnonzero(surface.x.nodes == 1500.0)[0], np.flatnonzero(surface.y.nodes == 8.0)[0]
    assert row.delta_W_c == surface.values[place]
    assert row.origin == ORIGINS[surface.origin[place]] == "estimated"


def test_xarray_has_axes_and_units(surface):
    pytest.importorskip("xarray", reason="a library of the extra lpvobs[notebook]")
    found = surface.to_xarray()
    assert found.delta_W_c.attrs["units"] == "kg/s"
    assert found.n_e.attrs["units"] == "rpm"
    near = found.delta_W_c.interp(n_e=1600.0, u_delta=9.0).item()
    assert near == pytest.approx(surface.at([(1600.0, 9.0)]).values[0])


def test_other_values_than_those_of_a_map_are_refused(chain):
    with pytest.raises(DataError, match="no values named 'metrics'; expected map or extrapolation"):
        package.read_map(chain.result, "metrics")


def test_plot_draws_in_grams(surface):
    with mpl.rc_context({"backend": "agg"}):
        from matplotlib import pyplot

        axes = surface.plot()
        assert np.nanmin(axes.collections[0].get_array()) == pytest.approx(1e3 * np.nanmin(surface.values))
        assert axes.get_xlabel().endswith("[mg/cycle]")
        pyplot.close("all")
