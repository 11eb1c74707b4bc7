"""Wrong engines and mixed-up logs are refused, or said beside the map; `benchmarks/wrong_engine.py` has all cases."""

import h5py
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from repository import CONFIGS


@pytest.fixture
def estimated(lpvobs, config, chain, table, tmp_path):
    """Return a function: what `estimate --json` says of the chain's log with some columns replaced."""

    def run(*options, **columns):
        log, changed = tmp_path / "drive.parquet", table
        for name, column in columns.items():
            place = table.column_names.index(name)
            changed = changed.set_column(place, table.schema.field(name), pa.array(column))
        pq.write_table(changed, log)
        return lpvobs(
            "estimate", "--config", config, "--gain", chain.gain, log, "--out", tmp_path / "map.h5", "--json", *options
        )

    return run


def test_nothing_is_said_of_a_right_engine(chain):
    said = chain.said
    assert said["doubts"] == []
    assert said["balance_agreement"]["ratio"] < 1.5
    assert said["balance_agreement"]["p_value"] > 0.01
    assert said["logs"][0]["balance_ratio"] == said["balance_agreement"]["ratio"]
    with h5py.File(chain.result) as file:
        assert file["balance_agreement"].attrs["ratio"] == said["balance_agreement"]["ratio"]
        assert file["balance_agreement"].attrs["doubts"] == ""


@pytest.mark.slow
def test_exchanged_channels_are_named_and_a_gate_can_ask(estimated, lpvobs, table, tmp_path):
    done = estimated(u_egr=table["u_vgt"].to_numpy(), u_vgt=table["u_egr"].to_numpy())
    assert done.code == 0, done.err
    (doubt,) = done.json["doubts"]
    assert doubt.startswith("drive: the log probably has u_egr and u_vgt exchanged")
    assert set(done.json["balance_agreement"]["where"]) == {"u_delta", "n_e"}
    gate = lpvobs("report", tmp_path / "map.h5", "--gate", "balance_ratio<=2.5")
    assert gate.code == 1
    assert "balance_ratio" in gate.err


@pytest.mark.slow
def test_an_order_that_no_engine_has_is_said(estimated, table):
    done = estimated(p_im=table["p_em"].to_numpy(), p_em=table["p_im"].to_numpy())
    doubts = done.json["doubts"] if done.code == 0 else [done.err]
    assert any("p_em is below p_im" in line for line in doubts), doubts


@pytest.mark.parametrize(
    ("factor", "why"), [pytest.param(3.6, "the sensor's unit", marks=pytest.mark.proof), (1e-3, "unplugged")]
)
@pytest.mark.slow
def test_a_map_larger_than_a_sensor_can_be_wrong_is_refused(estimated, table, tmp_path, factor, why):
    reading = table["W_maf"].to_numpy()
    done = estimated(W_maf=factor * reading + (0.002 if factor < 1 else 0.0))
    assert done.code == 3, done.out
    assert "expected at most 60 % (largest_error in [estimate])" in done.err
    assert why in done.err
    assert not (tmp_path / "map.h5").exists()


@pytest.mark.proof  # quick in api/test_doubts.py
def test_a_constant_that_is_off_is_said(lpvobs, config, chain, tmp_path):
    odd = tmp_path / "odd.toml"
    odd.write_text(config.read_text().replace("V_d = 1.910e-3", "V_d = 2.3e-3"))
    gain = lpvobs("synth-gain", "--config", odd, "--out", tmp_path / "odd.h5")
    assert gain.code == 0, gain.err
    done = lpvobs("estimate", "--config", odd, "--gain", tmp_path / "odd.h5", chain.log, "--out", tmp_path / "map.h5")
    assert done.code == 0, done.err
    assert "the air flow balances differ by" in done.err
    assert "check the constants in [engine]" in done.err


def test_a_gain_says_whom_it_is_for(lpvobs, config, chain):
    done = lpvobs("verify", chain.gain, "--config", config)
    assert done.code == 0, done.err
    assert "made for a diesel engine, constants " in done.out
    assert "T_im 280 to 400 K, T_em 270 to 1300 K" in done.out
    other = lpvobs("verify", chain.gain, "--config", CONFIGS / "heavy-duty.toml")
    assert other.code == 3
    assert "gain for another engine" in other.err


def test_a_gain_for_other_temperatures_is_refused(lpvobs, config, chain, tmp_path):
    odd = tmp_path / "odd.toml"
    odd.write_text(config.read_text().replace("T_im = [280, 400]", "T_im = [260, 400]"))
    done = lpvobs("estimate", "--config", odd, "--gain", chain.gain, chain.log, "--out", tmp_path / "map.h5")
    assert done.code == 3
    assert "was made for other temperatures: T_im is 280 to 400 K in the gain" in done.err
