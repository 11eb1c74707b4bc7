"""A small part of `make fuzz`, and what it found once."""

import pytest
from robust import foreign
from robust.fuzz import SHARES, Corpus, fuzz_kind, read, show

from lpvobs.errors import DataError, LpvobsError, UsageError
from lpvobs.io.configuration.config import load_config
from lpvobs.simulation.cycles import load_cycle


@pytest.mark.parametrize(
    ("kind", "number"),
    [
        ("parquet bytes", 140), ("parquet content", 140), ("toml", 140), ("hdf5 bytes", 40), ("hdf5 content", 40),
        ("csv", 130), ("mat hdf5", 2),
        *(pytest.param(kind, number, marks=pytest.mark.proof) for kind, number in (("mat", 3), ("mdf", 2))),
    ],
)  # fmt: skip
@pytest.mark.slow
def test_no_input_is_a_fault_of_the_program(samples, kind, number):
    found = fuzz_kind(samples, kind, range(7_000_000, 7_000_000 + number), lambda line: None)
    assert found == []


def test_the_shares_are_of_a_whole():
    assert sum(SHARES.values()) == pytest.approx(1.0, abs=1e-12)


def test_an_input_is_named_by_its_number(samples, tmp_path):
    corpus = Corpus(samples, tmp_path)
    for kind in SHARES:
        assert corpus.write(kind, 5).read_bytes() == corpus.write(kind, 5).read_bytes(), kind
        assert corpus.write(kind, 5).read_bytes() != corpus.write(kind, 6).read_bytes(), kind


@pytest.mark.slow
def test_an_input_can_be_looked_at_again():
    assert "checksum" in show("hdf5 bytes", 10_000_001)  # whatever byte it hits, the seal tells


def test_the_good_files_of_the_corpus_are_good(samples, tmp_path):
    for path in (samples.log, samples.gain, samples.result):
        copy = tmp_path / f"input.{path.stem if path.suffix == '.h5' else 'parquet'}"
        copy.write_bytes(path.read_bytes())
        read(copy)


@pytest.mark.parametrize(
    "make",
    [
        foreign.csv_seeds,
        pytest.param(foreign.hdf_seeds, marks=pytest.mark.slow),
        *(pytest.param(make, marks=pytest.mark.proof) for make in (foreign.mat_seeds, foreign.mdf_seeds)),
    ],
)
def test_the_good_recordings_of_the_corpus_are_good(make, tmp_path):
    for seed in make():
        path = tmp_path / f"input{seed.suffix}"
        path.write_bytes(seed.content)
        (tmp_path / "foreign.toml").write_text(seed.profile)
        read(path)


@pytest.mark.slow
def test_mutated_inputs_reach_the_readers(samples, tmp_path):
    """Otherwise the fuzzer would try the same refusal for ever."""
    corpus, seen = Corpus(samples, tmp_path), set()
    for number in range(60):
        try:
            read(corpus.write("hdf5 content", number))
            seen.add("good")
        except LpvobsError as error:
            seen.add(str(error).split("(")[-1][:20])
    assert "good" in seen
    assert len(seen) > 10


@pytest.mark.parametrize(
    "text", ["x = " + "[" * 100_000, "x = " + "9" * 5000, "a." * 50_000 + "a = 1", "x = '''" + "y" * 5_000_000]
)
def test_a_configuration_that_is_a_trap_is_a_usage_error(tmp_path, text):
    path = tmp_path / "trap.toml"
    path.write_text(text)
    with pytest.raises(UsageError) as failure:
        load_config(path)
    assert len(str(failure.value)) < 1000


@pytest.mark.parametrize("path", ["/dev/zero", "/dev/urandom", "/"])
def test_devices_are_not_read(path):
    from pathlib import Path

    with pytest.raises(UsageError):
        load_config(Path(path))


def test_a_device_in_the_place_of_a_cycle_is_not_read(tmp_path):
    link = tmp_path / "cycle.csv"
    link.symlink_to("/dev/zero")
    with pytest.raises(UsageError, match="is not a file"):
        load_cycle(str(link))


def test_a_result_whose_map_has_the_wrong_shape_is_damaged(samples, tmp_path):
    """Found by the fuzzer: a list as long as something else ended in a traceback of the report."""
    import h5py

    from lpvobs.io.results.hdf import changing
    from lpvobs.io.results.results import read_result

    path = tmp_path / "odd.h5"

    def replace(file: h5py.File, name: str, values: object) -> None:
        del file[name]
        file[name] = values

    for name, values in (
        ("map/delta_W_c", [1.0]), ("map/support", 1j), ("extrapolation/coefficients", [1.0, 2.0]), ("gain/state", [["a"]]),
        ("gain/L", [[1.0]]), ("sensitivity/constant", "text"), ("logs/drive/lower", [[1.0]]),
    ):  # fmt: skip
        with changing(samples.result, path) as file:
            replace(file, name, values)
        with pytest.raises(DataError, match="damaged"):
            read_result(path)
