"""The refined model as the observer has it: constants where the joint fit has them, gains that it can use."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest
from repository import DIESEL

import lpvobs
from lpvobs.api.trace import expect_cascade
from lpvobs.engines.constants import scaled
from lpvobs.errors import DataError, UsageError
from lpvobs.io.configuration.config import load_config


def test_constants_are_scaled_wherever_they_stand():
    engine = load_config(DIESEL)[0].engine
    moved = scaled(engine, {"V_d": 0.01, "J_t": -0.02})
    assert moved.geometry.V_d == pytest.approx(1.01 * engine.geometry.V_d)
    assert moved.turbine.J_t == pytest.approx(0.98 * engine.turbine.J_t)
    assert moved.compressor == engine.compressor
    assert scaled(engine, {}) == engine


def test_a_gain_through_which_the_sensor_bends_the_state_is_refused_in_one_line():
    L = np.zeros((3, 3))
    expect_cascade(Path("r.h5"), SimpleNamespace(origin="made", gain=SimpleNamespace(L=L)))
    L = L + np.array([0.0, 0.0, 1.0])
    with pytest.raises(DataError, match=r"^r.h5: this map was made with the gain 'Eq. \(38\)', .*--freeze-map$"):
        expect_cascade(Path("r.h5"), SimpleNamespace(origin="Eq. (38)", gain=SimpleNamespace(L=L)))


def test_a_drive_counts_once_and_has_a_name_of_its_own(chain, tmp_path):
    before = chain.result.read_bytes()
    with pytest.raises(UsageError, match=r"same content as .*, so leave one file out"):
        lpvobs.trace(chain.result, [chain.log, shutil.copy(chain.log, tmp_path / "other.parquet")])
    table, namesake = pq.read_table(chain.log), tmp_path / chain.log.name
    pq.write_table(table.slice(0, table.num_rows // 2), namesake)
    with pytest.raises(UsageError, match=f"log {chain.log.stem}: two logs have this name"):
        lpvobs.refine(chain.result, chain.log, tmp_path / "r.h5", hold_out=namesake)
    assert chain.result.read_bytes() == before
    assert list(tmp_path.glob("*.h5")) == []
