"""The loop on a real engine: the model from the healthy log alone, faults that somebody built in found without being told."""

from dataclasses import replace

import numpy as np
import pytest
from repository import LIU_ICE

from lpvobs.api.ingest_log import ingest_log
from lpvobs.discovery.throttled_closing import Nominal, close
from lpvobs.discovery.throttled_noise import healthy_errors
from lpvobs.engines.throttled.learning import learn
from lpvobs.io.configuration.config import load_config
from lpvobs.io.logs.reading import read_log

FAULTS = {
    "wltp_f_waf_110": ("maf.gain", 1.10),
    "wltp_f_pim_080": ("p_im.gain", 0.80),
    "wltp_f_pic_090": ("p_ic.gain", 0.90),
    "wltp_f_iml_6mm": ("leak.intake", None),
}
MORNING = 110.0  # s; the faults begin later


@pytest.fixture(scope="session")
def read(measured, tmp_path_factory):
    folder, config = tmp_path_factory.mktemp("liu-ice"), load_config(LIU_ICE)[0]
    made = {}

    def log(name):
        if name not in made:
            ingest_log([measured / "liu-ice" / f"{name}.csv"], "liu-ice", folder / f"{name}.parquet")
            made[name] = read_log(folder / f"{name}.parquet", config.engine_path().channels, config.policies)
        return made[name]

    return log


@pytest.fixture(scope="session")
def nominal(read):
    config, healthy = load_config(LIU_ICE)[0], read("wltp_NF")
    learned, errors = learn(config.engine, [healthy]), healthy_errors(config.engine, [healthy])
    return Nominal(config.engine, learned, errors, config.trace, {healthy.sha256: healthy.name})


def until(log, end):
    keep = log.time - log.time[0] < end
    channels = {name: values[keep] for name, values in log.channels.items()}
    count = int(keep.sum())
    return replace(log, time=log.time[keep], channels=channels, segments=((0, count),), rows=np.arange(count))


def judge(nominal, log):
    return close(nominal, [log], (), None, lambda _: None).trace


def test_the_balances_hold_on_parts_that_taught_nothing(nominal):
    # As the record of the data says: a flexible model reaches 6 %, speed-density 4 % robustly; physics ought to be better.
    throttle, filling, fuel, ambient = nominal.healthy.rms
    assert max(throttle, filling) < 0.03
    assert fuel < 0.08
    assert ambient < 0.005


def test_nothing_is_found_on_the_healthy_log_by_parts(nominal, read):
    assert judge(nominal, read("wltp_NF")).verdict == "none"


@pytest.mark.parametrize("name", ["wltp_NF", *FAULTS])
def test_nothing_is_found_before_the_fault_begins(nominal, read, name):
    morning = replace(until(read(name), MORNING), sha256="another file")
    assert judge(nominal, morning).verdict == "none"


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_that_somebody_built_in_is_named_sized_and_dated(nominal, read, name):
    expected, factor = FAULTS[name]
    found = judge(nominal, read(name))
    assert [item.id for item in found.findings] == [expected]
    (size,) = found.findings[0].parameters.values()
    if factor is not None:
        assert abs(size.value - factor) < 0.03  # what is asked for
    # The record of the data: between 115 and 135 s, differently in each file.
    assert 110.0 < found.findings[0].onset < 140.0
    assert found.comparison.after < found.comparison.before
    moved = {item.balance: item.recovered for item in found.logs[0].balances if item.affected}
    # Under the leak the mixture at idle is not stoichiometric, so the fuel keeps a rest that is no air.
    assert all(share > 0.7 for balance, share in moved.items() if (name, balance) != ("wltp_f_iml_6mm", "fuel"))
