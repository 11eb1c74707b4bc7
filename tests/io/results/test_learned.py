"""What a healthy log has taught comes back from a result as it was."""

from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from lpvobs.engines.curves import Knowledge, LearnedNumber
from lpvobs.engines.healthy import HealthyErrors
from lpvobs.engines.throttled.learning import NUMBERS
from lpvobs.engines.throttled.lpv import Throttled
from lpvobs.engines.throttled.relations import PARTS
from lpvobs.errors import DataError
from lpvobs.io.results.engines import Learning, read_learned, write_learned


def test_a_learned_engine_comes_back(tmp_path):
    rng = np.random.default_rng(3)
    nodes = SimpleNamespace(
        alpha_th=(1.0, 2.0, 3.0), n_e=(1e3, 2e3), p_im=(4e4, 9e4), m_f=(1.0, 2.0, 3.0), fuel_n_e=(1e3, 3e3)
    )
    root = rng.random((15, 15))  # 3 + 2 x 2 + 3 x 2 nodes and two volumes
    covariance = root @ root.T
    ends, values = np.cumsum([3, 4, 6]), (rng.random(3), rng.random((2, 2)), rng.random((3, 2)))
    spread = np.split(np.sqrt(np.diag(covariance)), ends)
    engine = SimpleNamespace(curves=nodes)
    curves = {part.name: part.curve(engine, *each) for part, *each in zip(PARTS, values, spread, strict=False)}
    numbers = {name: LearnedNumber(0.01, "1", name) for name in NUMBERS}
    learned = Knowledge(curves, numbers, covariance, ("day one",))
    healthy = HealthyErrors(rng.random(2), rng.random((3, 4)), rng.random((4, 4)), rng.random(4), rng.random(4))
    with h5py.File(tmp_path / "some.h5", "w") as file:
        with pytest.raises(DataError, match="calibrate --healthy"):
            read_learned(file)
        learning = Learning(learned, healthy, ("a", "b", "c", "d"))
        write_learned(file, learning)
        found = read_learned(file)
        assert found.balances == learning.balances
        again = Throttled(engine).knowing(found.known).learned
        assert (again.sources, again.digest(), again.names) == (learned.sources, learned.digest(), learned.names)
        for name, curve in again.curves.items():
            np.testing.assert_array_equal(curve.relative_error, learned.curves[name].relative_error)
        for name, value in vars(healthy).items():
            np.testing.assert_array_equal(getattr(found.healthy, name), value)
        error = file["engine/fuel/relative_error"]
        np.testing.assert_allclose(error[()].ravel() ** 2, np.diag(learned.covariance)[7:13], rtol=1e-14)
        assert [scale[0].name for scale in error.dims] == ["/engine/fuel/m_f", "/engine/fuel/n_e"]
