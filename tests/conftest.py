"""What every room's tests share: the engine and grid of the shipped configuration, and how Hypothesis draws."""

import fcntl
import json
import os
import shutil
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path

# Before NumPy is loaded: for a few hundred rows threads of the linear algebra cost more than they give, above all on a machine
# that has something else to do.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import verbs
from hypothesis import settings
from repository import CONFIGS, DIESEL, short_cycle

from lpvobs.engines.components.intake import Egr, Filling
from lpvobs.engines.diesel.constants import Compressor, DieselEngine, Gas, Geometry, Turbine
from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.maps.grid import Grid

# The same examples on every run, and no example fails for being the first to compile a kernel.
EXAMPLES = 8 if os.environ.get("NUMBA_DISABLE_JIT") == "1" else 40  # a hundred times slower without the compiler
settings.register_profile("repeatable", derandomize=True, deadline=None, database=None, max_examples=EXAMPLES)
settings.load_profile("repeatable")


DEAR = (
    "benchmarks/test_blind.py", "docs/test_commands.py", "benchmarks/test_thresholds.py",
    "measured/test_real_engine.py", "measured/test_blind.py", "cli/test_trace.py", "discovery/test_throttled.py",
    "robust/test_kill.py", "discovery/test_refine.py", "api/test_types.py", "contract/test_contract.py",
    "cli/test_fleet.py", "robust/test_same_bytes.py", "simulation/test_heavy_duty.py", "discovery/test_forms.py",
    "io/control_unit/test_control_unit.py", "selftest/test_selftest.py", "api/test_compare.py",
    "measured/test_road_car.py", "api/test_cluster.py", "cli/test_calibrate.py", "observer/test_estimate.py",
    "observer/test_any_number_of_states.py",
)  # fmt: skip
"""Files that take longest, the longest first: begun last, one of them would keep a single worker busy while the others are done."""


PROOFS = pytest.StashKey[list[str]]()


@pytest.fixture
def proofs(request: pytest.FixtureRequest) -> list[str]:
    """Return the tests marked `proof` among those that this run has read."""
    return request.config.stash[PROOFS]


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Begin with what takes longest; what follows stays in its order."""
    config.stash[PROOFS] = [item.nodeid for item in items if item.get_closest_marker("proof")]
    turn = {Path(__file__).parent / name: number for number, name in enumerate(DEAR)}
    assert [path for path in turn if not path.is_file()] == []
    items.sort(key=lambda item: turn.get(item.path, len(DEAR)))


def _record(kind, table):
    values = {item.name: table[item.name] for item in fields(kind) if item.name in table}
    return kind(**{name: tuple(value) if isinstance(value, list) else value for name, value in values.items()})


@pytest.fixture(scope="session")
def engine() -> DieselEngine:
    """Return the engine of configs/diesel.toml, read without the reader that has tests of its own."""
    tables = tomllib.loads(DIESEL.read_text(encoding="utf-8"))["engine"]
    kinds = {
        "gas": Gas,
        "geometry": Geometry,
        "filling": Filling,
        "compressor": Compressor,
        "turbine": Turbine,
        "egr": Egr,
    }
    return DieselEngine(**{name: _record(kind, tables[name]) for name, kind in kinds.items()})


@pytest.fixture(scope="session")
def air_path(engine) -> Diesel:
    return Diesel(engine)


@pytest.fixture(scope="session")
def grid() -> Grid:
    """Return the default grid of the contract, 15 fuel by 17 speed nodes."""
    return Grid(np.arange(0.0, 57.0, 4.0), np.arange(0.0, 4001.0, 250.0))


@pytest.fixture(scope="session")
def once(tmp_path_factory) -> Callable[[str, Callable[[Path], None]], Path]:
    """Return a function that fills a folder once for all workers of a run; who comes second waits and takes it as it is."""
    root = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        root = root.parent

    def fill(name: str, make: Callable[[Path], None]) -> Path:
        folder, done = root / name, root / f"{name}.done"
        with (root / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not done.exists():
                shutil.rmtree(folder, ignore_errors=True)  # of a worker that failed half-way
                folder.mkdir()
                make(folder)
                done.touch()
        return folder

    return fill


@pytest.fixture(scope="session")
def lpvobs() -> Callable[..., verbs.Done]:
    """Return a function that runs a command line in a process of its own."""
    return verbs.lpvobs


@pytest.fixture(scope="session")
def config() -> Path:
    return DIESEL


@dataclass(frozen=True)
class Chain:
    """One pass through the chain at 20 Hz. Every room's tests share the files: copy what is to be changed."""

    folder: Path
    name: str = "ftp75_cold"

    @property
    def log(self) -> Path:
        return self.folder / f"{self.name}.parquet"

    @property
    def gain(self) -> Path:
        return self.folder / "gain.h5"

    @property
    def result(self) -> Path:
        return self.folder / "result.h5"

    @property
    def said(self) -> dict:
        """What `estimate --json` said of the result."""
        return json.loads((self.folder / "estimate.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="session")
def chain(once) -> Chain:
    def make(folder: Path) -> None:
        new = Chain(folder)
        for step in (
            ("simulate", "--config", DIESEL, "--cycle", "ftp75_cold", "--rate", 20, "--seed", 3, "--out", new.log),
            ("synth-gain", "--config", DIESEL, new.log, "--out", new.gain),
            ("estimate", "--config", DIESEL, "--gain", new.gain, new.log, "--out", new.result, "--json"),
            ("extrapolate", new.result),
        ):
            done = verbs.lpvobs(*step)
            assert done.code == 0, f"{step}: {done.err}"
            if step[0] == "estimate":
                (folder / "estimate.json").write_text(done.out, encoding="utf-8")

    return Chain(once("chain", make))


@pytest.fixture(scope="session")
def table(chain):
    """Return the log of the chain as a table of Arrow's."""
    return pq.read_table(chain.log)


@pytest.fixture(scope="session")
def page(once, chain) -> Path:
    """Return the page of the chain's result and its log."""

    def make(folder: Path) -> None:
        done = verbs.lpvobs("report", chain.result, chain.log, "--html", folder / "page.html")
        assert done.code == 0, done.err

    return once("page", make) / "page.html"


@pytest.fixture(scope="session")
def bare(once, chain, table) -> Chain:
    """Return the chain's log without the truth, which real logs have not, and its map by the same gain."""

    def make(folder: Path) -> None:
        new = Chain(folder, "bare")
        pq.write_table(table.drop_columns(["ref_W_c", "ref_delta_W_c"]), new.log)
        done = verbs.lpvobs("estimate", "--config", DIESEL, "--gain", chain.gain, new.log, "--out", new.result)
        assert done.code == 0, done.err

    return Chain(once("bare", make), "bare")


PIECES = 4


@pytest.fixture(scope="session")
def pieces(once, table) -> Path:
    """Return a folder with the chain's log in pieces that overlap by half: different logs of one map."""

    def make(folder: Path) -> None:
        length = 2 * table.num_rows // (PIECES + 1)
        for number in range(PIECES):
            pq.write_table(table.slice(number * length // 2, length), folder / f"drive {number}.parquet")

    return once("pieces", make)


def _kept(folder: Path, *call: str | Path | int) -> None:
    """Run a command line and write what it said into a folder."""
    done = verbs.lpvobs(*call)
    (folder / "said.json").write_text(json.dumps([done.code, done.out, done.err]), encoding="utf-8")


def _told(folder: Path) -> verbs.Done:
    return verbs.Done(*json.loads((folder / "said.json").read_text(encoding="utf-8")))


@pytest.fixture(scope="session")
def together(once, chain, pieces) -> tuple[Path, verbs.Done]:
    """Return the map of the pieces, made one after the other, and what was said."""

    def make(folder: Path) -> None:
        call = ("estimate", "--config", DIESEL, "--gain", chain.gain, pieces, "--jobs", 1)
        _kept(folder, *call, "--out", folder / "r.h5", "--json")

    folder = once("together", make)
    done = _told(folder)
    assert done.code == 0, done.err
    return folder / "r.h5", done


@pytest.fixture(scope="session")
def with_a_bad_one(once, chain, pieces) -> tuple[Path, Path, verbs.Done]:
    """Return the map of the pieces and a log that is none, made side by side, the one that is none, and what was said."""

    def make(folder: Path) -> None:
        (folder / "bad.parquet").write_bytes(b"PAR1")
        call = ("estimate", "--config", DIESEL, "--gain", chain.gain, pieces, folder / "bad.parquet", "--jobs", 2)
        _kept(folder, *call, "--out", folder / "r.h5", "--json")

    folder = once("with_a_bad_one", make)
    return folder / "r.h5", folder / "bad.parquet", _told(folder)


@pytest.fixture(scope="session")
def slow(once) -> Path:
    """Return the chain's drive, with the same noise, of a sensor that follows the flow with a lag of 0.1 s."""

    def make(folder: Path) -> None:
        (folder / "lag.toml").write_text('[[effect]]\nid = "maf.lag"\ntau = 0.1\n', encoding="utf-8")
        drive = ("simulate", "--config", DIESEL, "--cycle", "ftp75_cold", "--rate", 20, "--seed", 3)
        done = verbs.lpvobs(*drive, "--effects", folder / "lag.toml", "--out", folder / "slow.parquet")
        assert done.code == 0, done.err

    return once("slow", make) / "slow.parquet"


@pytest.fixture(scope="session")
def refined(once, chain, slow) -> tuple[Path, dict]:
    """Return the chain's result refined on the slow sensor, and what was said; another log was held out."""

    def make(folder: Path) -> None:
        other = folder / "other.parquet"
        pq.write_table(pq.read_table(slow).slice(3000, 4000), other)
        call = ("refine", chain.result, slow, "--hold-out", other, "--out", folder / "refined.h5", "--json")
        done = verbs.lpvobs(*call)
        assert done.code == 0, done.err
        (folder / "said.json").write_text(done.out, encoding="utf-8")

    folder = once("refined", make)
    return folder / "refined.h5", json.loads((folder / "said.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="session")
def traced(once, chain, slow) -> tuple[Path, Path, verbs.Done]:
    """Return the chain's result traced on a log that is none and on the slow sensor's, the one that is none, and what was said."""

    def make(folder: Path) -> None:
        result, bad = folder / "result.h5", folder / "bad.parquet"
        shutil.copy(chain.result, result)
        bad.write_bytes(slow.read_bytes()[:5000])
        _kept(folder, "trace", result, bad, slow, "--json")

    folder = once("traced", make)
    return folder / "result.h5", folder / "bad.parquet", _told(folder)


@pytest.fixture(scope="session")
def rewritten():
    """Return a function that writes a table to a path with other units."""

    def write(table, path, **units):
        fields = [
            pa.field(f.name, f.type, metadata={"unit": units.get(f.name, f.metadata[b"unit"].decode())})
            for f in table.schema
        ]
        pq.write_table(pa.table(table.columns, schema=pa.schema(fields)), path)

    return write


@dataclass(frozen=True)
class OtherEngine:
    """An engine whose displacement and compressor are not the configuration's, and with waves in its intake runners."""

    folder: Path

    @property
    def config(self) -> Path:
        return self.folder / "truth.toml"

    @property
    def bench(self) -> Path:
        return self.folder / "bench.csv"

    @property
    def drive(self) -> Path:
        return self.folder / "drive.parquet"

    @property
    def healthy(self) -> Path:
        return self.folder / "healthy.parquet"

    @property
    def known(self) -> Path:
        return self.folder / "engine.h5"


@pytest.fixture(scope="session")
def other_engine(once) -> OtherEngine:
    """Return 40 bench points, a drive and a short healthy one of another engine, and what `calibrate` makes of the bench."""

    def make(folder: Path) -> None:
        new = OtherEngine(folder)
        text = DIESEL.read_text(encoding="utf-8")
        for before, after in (
            ("V_d = 1.910e-3", "V_d = 1.925e-3"),
            ("R_c = 0.0245", "R_c = 0.0243"),
            ("wave = 0.0", "wave = 1.0"),
        ):
            assert before in text
            text = text.replace(before, after)
        new.config.write_text(text, encoding="utf-8")
        drive = ("simulate", "--config", new.config, "--rate", 20)
        right = ("--effects", CONFIGS / "surfaces" / "zero.toml")
        for step in (
            ("simulate", "--config", new.config, "--bench", 40, "--out", new.bench),
            (*drive, "--cycle", "ftp75_cold", "--out", new.drive),
            (*drive, "--cycle", short_cycle(folder), *right, "--out", new.healthy),
            ("calibrate", "--config", DIESEL, "--bench", new.bench, "--out", new.known),
        ):
            done = verbs.lpvobs(*step)
            assert done.code == 0, f"{step}: {done.err}"

    return OtherEngine(once("other_engine", make))
