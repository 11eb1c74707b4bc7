"""ENGINE.h5: what was found comes back, and what belongs to another engine does not."""

from dataclasses import replace

import h5py
import numpy as np
import pytest

from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.engines.unknowns import LeftAtNodes
from lpvobs.errors import DataError
from lpvobs.io.results.engines import read_engine, write_engine


@pytest.fixture(scope="module")
def stored(other_engine, air_path):
    return read_engine(other_engine.known, air_path)


def test_what_is_written_comes_back(stored, air_path, tmp_path):
    write_engine(tmp_path / "again.h5", stored)
    again = read_engine(tmp_path / "again.h5", air_path)
    for name in ("mean", "covariance"):
        np.testing.assert_array_equal(getattr(again.unknowns, name), getattr(stored.unknowns, name))
    np.testing.assert_array_equal(again.prior_error, stored.prior_error)
    assert again.unknowns.names == stored.unknowns.names
    assert again.unknowns.learned
    assert again.rows == stored.rows
    assert (again.amplitudes, again.left, again.constants) == (stored.amplitudes, stored.left, stored.constants)
    assert again.provenance == stored.provenance


def test_what_is_left_at_the_nodes_comes_back(stored, air_path, grid, tmp_path):
    rng, p, q = np.random.default_rng(2), grid.size, stored.unknowns.size
    at_nodes = LeftAtNodes(
        grid.fuel, grid.speed, rng.standard_normal(p), rng.standard_normal((p, q)), rng.standard_normal((p, p))
    )
    assert stored.unknowns.at_nodes is None  # a bench teaches none
    write_engine(tmp_path / "days.h5", replace(stored, unknowns=replace(stored.unknowns, at_nodes=at_nodes)))
    again = read_engine(tmp_path / "days.h5", air_path).unknowns.at_nodes
    for name, value in vars(at_nodes).items():
        np.testing.assert_array_equal(getattr(again, name), value, err_msg=name)


def test_the_covariance_is_one_and_smaller_than_before(stored):
    assert np.linalg.eigvalsh(stored.unknowns.covariance).min() > -1e-12
    assert (stored.error <= stored.prior_error * (1.0 + 1e-9)).all()
    assert stored.determined[stored.unknowns.names.index("R_c")]


def test_corrections_lie_over_their_own_axes(other_engine, stored):
    with h5py.File(other_engine.known) as file:
        group = file["components/eta_vol"]
        assert [dimension[0].name.rsplit("/", 1)[1] for dimension in group["correction"].dims] == ["n_e", "p_im"]
        np.testing.assert_array_equal(
            group["correction"][()].ravel(), stored.unknowns.mean[stored.unknowns.places()["eta_vol"]]
        )


def test_another_engine_is_refused(other_engine, engine):
    other = Diesel(replace(engine, geometry=replace(engine.geometry, V_d=2e-3)))
    with pytest.raises(
        DataError, match=r"another engine: the constant V_d is 0.00191 in this file and 0.002 in the configuration"
    ):
        read_engine(other_engine.known, other)


def test_a_damaged_file_and_another_kind_are_refused(other_engine, chain, air_path, tmp_path):
    broken = bytearray(other_engine.known.read_bytes())
    broken[len(broken) // 2] ^= 1
    (tmp_path / "broken.h5").write_bytes(broken)
    with pytest.raises(DataError, match="damaged"):
        read_engine(tmp_path / "broken.h5", air_path)
    with pytest.raises(DataError, match="not an engine file"):
        read_engine(chain.gain, air_path)


def test_what_is_not_finite_is_refused(other_engine, air_path, tmp_path):
    path = tmp_path / "engine.h5"
    path.write_bytes(other_engine.known.read_bytes())
    with h5py.File(path, "r+") as file:
        file["unknowns/mean"][0] = np.nan
    with pytest.raises(DataError, match="'mean'"):
        read_engine(path, air_path)
