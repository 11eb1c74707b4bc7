"""Six drives of a road car, from CSV to what differs between summer and winter; nothing here is a measure of accuracy."""

import numpy as np
import pytest
from repository import CONFIGS

import lpvobs


@pytest.mark.proof
def test_six_drives_give_the_map_of_what_differs_between_summer_and_winter(measured, tmp_path):
    files = sorted((measured / "kit-obd").glob("*.csv"))
    assert len(files) == 6
    config, gain = CONFIGS / "speed_density.toml", tmp_path / "gain.h5"
    lpvobs.synth_gain(config, out=gain)
    logs = []
    for number, file in enumerate(files):
        logs.append(tmp_path / f"drive{number}.parquet")
        done = lpvobs.ingest_log([file], "kit-obd", logs[-1])
        assert done["channels"]["p_im"]["rate"] < 2.0  # the rate of the polls, not that of the rows
    for season, own in (("summer", logs[:3]), ("winter", logs[3:])):
        found = lpvobs.estimate(config, own, gain=gain, out=tmp_path / f"{season}.h5")
        assert any("confounded" in text for text in found.doubts.says)
    change = lpvobs.compare(tmp_path / "summer.h5", tmp_path / "winter.h5")
    assert change.nodes >= 8
    assert np.isfinite(change.mean.value)
    assert change.mean.ci90[0] < change.mean.value < change.mean.ci90[1]
