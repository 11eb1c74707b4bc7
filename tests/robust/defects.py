"""Every defect of a log that is known, with what happens to it: the cases of test_defects.py and the rows of docs/defects.md."""

import fcntl
from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from repository import ROOT

from lpvobs.api.inspect import inspect_log
from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.errors import DataError
from lpvobs.io.logs import parquet
from lpvobs.io.logs.policies import LogPolicies
from lpvobs.io.safety.atomic import replacing

UNITS = {"time": "s"} | {name: channel.unit for name, channel in Diesel.channels.items()}
N = 20_000
RATE = 100.0
GROUPS = ("Samples", "Time", "Units", "Types", "Files", "Outputs", "No defect")


def moving(seed=0):
    """Return every channel of the contract for 200 s of driving: speed and load move all the time, sensors are noisy."""
    rng = np.random.default_rng(seed)
    t = np.arange(N) / RATE
    load, speed = 0.5 + 0.5 * np.sin(0.4 * t), 0.5 + 0.5 * np.sin(0.13 * t + 1.0)
    exact = {
        "n_e": 900.0 + 2500.0 * speed,
        "u_delta": 5.0 + 35.0 * load,
        "u_egr": 40.0 * (1.0 - load),
        "u_vgt": 20.0 + 50.0 * load,
        "p_im": 1.0e5 + 8.0e4 * load * speed,
        "p_em": 1.1e5 + 1.2e5 * load * speed,
        "omega_t": 2000.0 + 9000.0 * np.sqrt(load * speed),
        "T_im": 305.0 + 20.0 * load,
        "T_em": 450.0 + 400.0 * load,
        "W_maf": 0.008 + 0.06 * load * speed,
    }
    noisy = {name: value * (1.0 + 2e-3 * rng.standard_normal(N)) for name, value in exact.items()}
    return {"time": t, **noisy, "p_amb": np.full(N, 9.8e4), "T_amb": np.full(N, 298.0)}


class Bench:
    """A folder, a good log to spoil, and what `inspect` says of the spoiled one."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.log = moving()
        self.units = dict(UNITS)
        self.path = folder / "drive.parquet"

    def write(self, twice=(), **types):
        """Write the log; `twice` names channels to write again, `types` gives Arrow arrays for some channels."""
        arrays = {name: types.get(name, column) for name, column in self.log.items()}
        pairs = [*arrays.items(), *((name, arrays[name]) for name in twice)]
        columns = [item if isinstance(item, pa.Array) else pa.array(item) for _, item in pairs]
        fields = [
            pa.field(name, column.type, metadata={"unit": self.units[name]} if name in self.units else None)
            for (name, _), column in zip(pairs, columns, strict=True)
        ]
        pq.write_table(pa.table(columns, schema=pa.schema(fields)), self.path)
        return self

    def inspect(self, **policies):
        return inspect_log(self.path, Diesel.channels, LogPolicies(**policies))

    def kept(self, samples, *defects, **policies):
        """Assert that so many samples remain, and that exactly these defects are shown: (defect, channel, count, policy)."""
        content = self.inspect(**policies)
        shown = [(item.defect, item.channel, item.count, item.policy) for item in content.defects]
        assert shown == list(defects), shown
        assert content.samples == samples
        assert content.samples_read >= samples
        return content

    def refused(self, *words, **policies):
        """Assert that the log is refused in one line with the file and these words."""
        try:
            self.inspect(**policies)
        except DataError as refusal:
            text = str(refusal)
            assert len(text.splitlines()) == 1, text
            for word in (str(self.path), *words):
                assert word in text, (word, text)
            return
        raise AssertionError("not refused")


@dataclass(frozen=True)
class Case:
    group: str
    defect: str
    policy: str
    shown: str
    check: Callable[[Bench], None]


CASES: list[Case] = []


def case(group, defect, policy, shown):
    """Register a check as a row of the table."""

    def register(check):
        CASES.append(Case(group, defect, policy, shown, check))
        return check

    return register


IN_REFUSAL = "message with file and channel"
IN_REFUSAL_AND = "message with file, channel and "

# --- samples -----------------------------------------------------------------------------------------------------------


@case("Samples", "NaN in single samples or in runs", "drop", "count per channel")
def _(bench):
    bench.log["p_im"][100:150] = np.nan
    bench.log["T_em"][[140, 9000]] = np.nan
    bench.write().kept(N - 51, ("no reading", "p_im", 50, "drop"), ("no reading", "T_em", 2, "drop"))


@case("Samples", "infinite reading", "drop", "count per channel")
def _(bench):
    bench.log["W_maf"][7:10] = [np.inf, -np.inf, np.inf]
    bench.log["p_em"][::20] = -np.inf  # no pressure below the ambient one
    bench.write().kept(N - N // 20 - 3, ("no reading", "p_em", N // 20, "drop"), ("no reading", "W_maf", 3, "drop"))


@case("Samples", "null (empty entry)", "drop", "count per channel")
def _(bench):
    n_e = pa.array([None if k in (5, 6) else float(v) for k, v in enumerate(bench.log["n_e"])])
    bench.write(n_e=n_e).kept(N - 2, ("no reading", "n_e", 2, "drop"))


@case(
    "Samples", "a run of missing samples longer than `gap_limit`", "drop, then split", "count per channel, and the gap"
)
def _(bench):
    bench.log["u_vgt"][4000:4500] = np.nan
    content = bench.write().kept(N - 500, ("no reading", "u_vgt", 500, "drop"), ("gap", "time", 1, "split"))
    assert content.segments == 2


@case("Samples", "a channel without any number", "refuse", IN_REFUSAL)
def _(bench):
    bench.log["T_em"][:] = np.nan
    bench.write().refused("'T_em'", "no number")


@case(
    "Samples",
    "readings that no working sensor gives, in up to 10 % of the samples of a channel",
    "drop",
    "count per channel",
)
def _(bench):
    bench.log["p_im"][[10, 11]] = [1e30, -5.0]
    bench.write().kept(N - 2, ("no reading", "p_im", 2, "drop"))


@case(
    "Samples",
    "readings that no working sensor gives, in more than 10 % of the samples of a channel",
    "refuse",
    IN_REFUSAL_AND + "share of the readings",
)
def _(bench):
    bench.log["T_im"][: N // 4] = 5000.0
    bench.write().refused("'T_im'", "25 %", "unit")


@case(
    "Samples",
    "stuck channel: it does not change at all for longer than 30 s (`W_maf`, `omega_t`), 60 s (`n_e`, `p_em`), 120 s (`p_im`) or "
    "300 s (fuel and temperatures), while at least two other channels move by 30 % of their range",
    "drop",
    "count per channel, first time stamp",
)
def _(bench):
    bench.log["W_maf"][3000:7000] = 0.02
    content = bench.write().kept(N - 4000, ("stuck", "W_maf", 4000, "drop"), ("gap", "time", 1, "split"))
    assert content.defects[0].first == 30.0


@case("Samples", "dead channel: one value in the whole log, while the other channels move", "refuse", IN_REFUSAL)
def _(bench):
    bench.log["omega_t"][:] = 4000.0
    bench.write().refused("'omega_t'", "stuck")


@case(
    "Samples",
    "unplugged sensor: `W_maf`, at zero or at another value, follows neither speed nor intake pressure nor turbine speed",
    "refuse",
    IN_REFUSAL,
)
def _(bench):
    noise = np.random.default_rng(1).standard_normal(N)
    for level, spread in ((0.0, 0.0), (0.11, 0.0), (0.0, 1e-4), (0.11, 1e-4)):
        bench.log["W_maf"] = level + spread * noise
        bench.write().refused("'W_maf'", "unplugged", "n_e, p_im, omega_t")
    bench.log["n_e"], bench.log["p_im"], bench.log["omega_t"] = 2000.0 + noise, 1.2e5 + noise, 8000.0 + noise
    bench.write().kept(N)  # an engine that stands at one point on a bench gives nothing to follow


@case(
    "Samples",
    "saturated channel (pressures, speeds, air flow): runs of samples exactly at the largest reading, at least three times as many "
    "as just below it",
    "drop",
    "count per channel, first time stamp",
)
def _(bench):
    top = 1.5e5
    over = bench.log["p_im"] > top
    bench.log["p_im"] = np.minimum(bench.log["p_im"], top)
    (found,) = [item for item in bench.write().inspect().defects if item.defect == "saturated"]
    assert (found.channel, found.policy) == ("p_im", "drop")
    # Runs shorter than ten samples, where noise leads in and out of the limit, are not counted.
    assert 0.95 * np.count_nonzero(over) <= found.count <= np.count_nonzero(over)


@case(
    "Samples",
    "spike: one sample differs from two neighbours that agree (at most 30 ms away) by over 10 % of the typical range and by over "
    "30 times the noise",
    "drop",
    "count per channel, first time stamp",
)
def _(bench):
    bench.log["p_em"][[500, 9000]] += 2e5
    bench.log["n_e"][777] = 100.0
    bench.write().kept(N - 3, ("spike", "n_e", 1, "drop"), ("spike", "p_em", 2, "drop"))


# --- time --------------------------------------------------------------------------------------------------------------


@case("Time", "a time step longer than `gap_limit`", "split", "number of gaps and segments")
def _(bench):
    bench.log["time"][5000:] += 60.0
    content = bench.write().kept(N, ("gap", "time", 1, "split"))
    assert content.segments == 2


@case(
    "Time",
    "repeated time stamps",
    "refuse",
    "message with count, first time stamp, its row, and the policy that would repair it",
)
def _(bench):
    bench.log["time"][[300, 400]] = bench.log["time"][[299, 399]]
    bench.write().refused("'time'", "2 times", "row 300", "backward_time")


@case(
    "Time",
    'repeated or backward time stamps, with `backward_time = "drop"`, in up to 10 % of the samples',
    "drop",
    "count",
)
def _(bench):
    bench.log["time"][1000:] -= 0.05
    bench.write().kept(N - 5, ("repeated or backward", "time", 5, "drop"), backward_time="drop")


@case(
    "Time",
    "backward time",
    "refuse",
    "message with count, first time stamp, its row, and the policy that would repair it",
)
def _(bench):
    bench.log["time"][1000:] -= 5.0
    bench.write().refused("'time'", "backward", "row 1000")


@case(
    "Time",
    "wrapped time: the counter starts again at zero",
    "refuse for any `backward_time`",
    "message with first time stamp and its row",
)
def _(bench):
    bench.log["time"] %= 65.536
    bench.write().refused("backward", "row 6554")
    bench.refused("backward", "10 %", backward_time="drop")


@case(
    "Time",
    "rows not sorted by time",
    "refuse for any `backward_time`",
    "message with count, first time stamp and its row",
)
def _(bench):
    order = np.random.default_rng(1).permutation(N)
    bench.log = {name: column[order] for name, column in bench.log.items()}
    bench.write().refused("backward")
    bench.refused("backward", backward_time="drop")


@case("Time", "all time stamps equal", "refuse", "message")
def _(bench):
    bench.log["time"][:] = 3.0
    bench.write().refused("'time'", "repeats")


@case("Time", "time stamp that is NaN or infinite", "drop", "count")
def _(bench):
    bench.log["time"][[4, 5]] = [np.nan, np.inf]
    bench.write().kept(N - 2, ("no reading", "time", 2, "drop"))


@case("Time", "log without rows", "refuse", "message")
def _(bench):
    bench.log = {name: column[:0] for name, column in bench.log.items()}
    bench.write().refused("no rows")


@case("Time", "log with one row", "refuse", "message")
def _(bench):
    bench.log = {name: column[:1] for name, column in bench.log.items()}
    bench.write().refused("at least two")


@case(
    "Time",
    "milliseconds labelled as seconds: the median time step is above `gap_limit`",
    "refuse",
    "message with the median time step",
)
def _(bench):
    bench.log["time"] *= 1e3
    bench.write().refused("'time'", "median step", "unit")


@case(
    "Time",
    "seconds labelled as milliseconds, or hours as seconds: the median time step is under 0.2 ms",
    "refuse",
    "message with the median time step",
)
def _(bench):
    bench.units["time"] = "ms"
    bench.write().refused("'time'", "median step", "unit")


# --- units -------------------------------------------------------------------------------------------------------------


@case("Units", "channel without a unit", "refuse", IN_REFUSAL_AND + "expected unit")
def _(bench):
    del bench.units["omega_t"]
    bench.write().refused("'omega_t'", "no unit", "'rad/s'")


@case("Units", "an unknown unit", "refuse", IN_REFUSAL_AND + "both units: found and expected")
def _(bench):
    bench.units["p_im"] = "inHg?"
    bench.write().refused("'p_im'", "'inHg?'", "'Pa'")


@case("Units", "a unit of another quantity", "refuse", IN_REFUSAL_AND + "both units: found and expected")
def _(bench):
    bench.units["p_im"] = "K"
    bench.write().refused("'p_im'", "'K'", "'Pa'")


@case(
    "Units",
    "another unit of the same quantity, even if it differs between the logs of one run",
    "repair: converted",
    "the unit in the file",
)
def _(bench):
    plain = bench.write().inspect()
    for name, unit, factor in (
        ("p_im", "kPa", 1e-3),
        ("p_em", "bar", 1e-5),
        ("W_maf", "kg/h", 3600.0),
        ("n_e", "1/min", 1.0),
    ):
        bench.log[name] = bench.log[name] * factor
        bench.units[name] = unit
    content = bench.write().kept(N)
    assert content.channels["p_im"].unit_in_file == "kPa"
    for name, item in content.channels.items():
        # Two roundings of a factor each.
        np.testing.assert_allclose(item.median, plain.channels[name].median, rtol=1e-14)


def _wrong(defect, channel, factor, offset, policy="refuse"):
    """Register a wrong unit or sign that the readings betray."""

    @case("Units", defect, policy, IN_REFUSAL_AND + "the implausible reading")
    def _(bench):
        bench.log[channel] = bench.log[channel] * factor + offset
        bench.write().refused(f"'{channel}'", "unit")


for _channel in ("p_im", "p_em", "p_amb"):
    _wrong(f"kPa labelled as Pa (`{_channel}`)", _channel, 1e-3, 0.0)
_wrong("bar labelled as Pa", "p_im", 1e-5, 0.0)
_wrong("gauge pressure labelled as absolute", "p_im", 1.0, -9.8e4)
_wrong("Pa labelled as kPa", "p_im", 1e3, 0.0)
for _channel in ("T_im", "T_amb"):
    _wrong(f"degrees C labelled as K (`{_channel}`)", _channel, 1.0, -273.15)
_wrong("degrees C labelled as K (`T_em`): the exhaust is colder than the air outside", "T_em", 1.0, -273.15 - 100.0)
_wrong("rad/s labelled as rpm (`n_e`)", "n_e", 2 * np.pi / 60, 0.0)
_wrong("rpm labelled as rad/s (`n_e`)", "n_e", 60 / (2 * np.pi), 0.0)
_wrong("rpm labelled as rad/s (`omega_t`)", "omega_t", 60 / (2 * np.pi), 0.0)
_wrong("g/s or kg/h labelled as kg/s (`W_maf`)", "W_maf", 1e3, 0.0)
_wrong("kg/s labelled as g/s or kg/h (`W_maf`)", "W_maf", 1e-3, 0.0)
_wrong("g labelled as mg (`u_delta`)", "u_delta", 1e-3, 0.0)
_wrong("a fraction labelled as per cent (`u_egr`, `u_vgt`)", "u_vgt", 1e-2, 0.0)
_wrong("wrong sign", "u_delta", -1.0, 0.0)

# --- types -------------------------------------------------------------------------------------------------------------


@case("Types", "whole numbers, of any width", "repair: read as floats", "nothing")
def _(bench):
    bench.log["n_e"] = np.round(bench.log["n_e"]).astype(np.int16)
    bench.log["p_im"] = np.round(bench.log["p_im"]).astype(np.uint32)
    bench.write().kept(N)


@case("Types", "half and single precision", "repair: read as floats", "nothing")
def _(bench):
    bench.log["T_im"] = bench.log["T_im"].astype(np.float16)
    bench.log["p_im"] = bench.log["p_im"].astype(np.float32)
    bench.write().kept(N)


@case("Types", "decimal numbers", "repair: read as floats", "nothing")
def _(bench):
    exact = pa.array([Decimal(f"{value:.3f}") for value in bench.log["T_em"]], type=pa.decimal128(12, 3))
    content = bench.write(T_em=exact).kept(N)
    assert abs(content.channels["T_em"].max - bench.log["T_em"].max()) <= 5e-4  # rounded to a thousandth


@case("Types", "dictionary-encoded numbers", "repair: read as floats", "nothing")
def _(bench):
    bench.write(p_amb=pa.array(bench.log["p_amb"]).dictionary_encode()).kept(N)


@case("Types", "true and false in a needed channel", "refuse: taken for a fraction labelled as per cent", IN_REFUSAL)
def _(bench):
    bench.write(u_egr=pa.array(bench.log["u_egr"] > 20.0)).refused("'u_egr'", "fraction")


@case(
    "Types",
    "true and false in another channel",
    "repair: read as 0 and 1",
    "the channel, in the list of auxiliary channels",
)
def _(bench):
    bench.log["fan"] = np.arange(N) % 2 == 0
    assert bench.write().kept(N).channels["fan"].max == 1.0


@case("Types", "text, even if it looks like numbers", "refuse", IN_REFUSAL_AND + "data type")
def _(bench):
    bench.write(n_e=pa.array([f"{value:.1f}" for value in bench.log["n_e"]])).refused("'n_e'", "string")


@case("Types", "dictionary-encoded text, lists, structures, bytes", "refuse", IN_REFUSAL_AND + "data type")
def _(bench):
    for odd in (pa.array(["1.0"] * N).dictionary_encode(), pa.array([[1.0]] * N), pa.array([b"1"] * N)):
        bench.write(T_im=odd).refused("'T_im'", "expected numbers")


@case(
    "Types",
    "time of day or date instead of seconds, with or without time zone",
    "refuse",
    IN_REFUSAL_AND + "data type",
)
def _(bench):
    stamps = (1_700_000_000_000 + 10 * np.arange(N)).astype("datetime64[ms]")
    for zone in (None, "Europe/Berlin"):
        bench.write(time=pa.array(stamps, type=pa.timestamp("ms", tz=zone))).refused("'time'", "timestamp")


@case("Types", "nanoseconds since 1970 as whole numbers, unit `ns`", "repair: converted", "nothing")
def _(bench):
    bench.log["time"] = 1_700_000_000_000_000_000 + 10_000_000 * np.arange(N)
    bench.units["time"] = "ns"
    content = bench.write().kept(N)
    assert abs(content.rate - 100.0) < 0.01  # a float of 1.7e9 s resolves 0.24 microseconds


# --- files -------------------------------------------------------------------------------------------------------------


@case("Files", "a needed channel is missing", "refuse", IN_REFUSAL_AND + "the channels that the file has")
def _(bench):
    del bench.log["W_maf"]
    bench.write().refused("'W_maf'", "missing", "T_em")


@case("Files", "a needed channel that is there twice", "refuse", IN_REFUSAL)
def _(bench):
    bench.write(twice=("p_em",)).refused("'p_em'", "2 times")


@case("Files", "another channel that is there twice", "drop this channel", "nothing")
def _(bench):
    bench.log["fan"] = np.ones(N)
    assert "fan" not in bench.write(twice=("fan",)).kept(N).channels


@case("Files", "no such file, or a folder or device in its place", "refuse", "message")
def _(bench):
    bench.refused("no such log")
    bench.path = bench.folder
    bench.refused("no such log")
    bench.path = Path("/dev/zero")
    bench.refused("no such log")


@case("Files", "an empty file", "refuse", "message")
def _(bench):
    bench.path.write_bytes(b"")
    bench.refused("Parquet")


@case("Files", "a truncated file", "refuse", "message")
def _(bench):
    whole = bench.write().path.read_bytes()
    for share in (0.01, 0.5, 0.9999):
        bench.path.write_bytes(whole[: int(share * len(whole))])
        bench.refused("Parquet")


@case("Files", "a corrupted file", "refuse", "message")
def _(bench):
    content = bytearray(bench.write().path.read_bytes())
    content[8 : len(content) // 2] = b"\xff" * (len(content) // 2 - 8)
    bench.path.write_bytes(content)
    bench.refused()


@case("Files", "a file of another format: CSV, HDF5, a picture", "refuse", "message")
def _(bench):
    for content in (b"time,n_e\n0,800\n", b"\x89HDF\r\n\x1a\n" + bytes(4096), b"\x89PNG\r\n\x1a\n"):
        bench.path.write_bytes(content)
        bench.refused("Parquet")


@case("Files", "an encrypted or password-protected file", "refuse", "message")
def _(bench):
    content = bytearray(bench.write().path.read_bytes())
    content[:4] = content[-4:] = b"PARE"  # what an encrypted footer begins and ends with
    bench.path.write_bytes(content)
    bench.refused("not a readable Parquet log")


@case("Files", "a file that changes while it is read", "refuse", "message")
def _(bench):
    bench.write()
    digest = parquet.log_digest

    def meanwhile(path):
        with path.open("ab") as other:
            other.write(b"more")
        return digest(path)

    parquet.log_digest = meanwhile
    try:
        bench.refused("changed while it was read")
    finally:
        parquet.log_digest = digest


@case("Files", "a channel name that is not UTF-8", "refuse", "message")
def _(bench):
    bench.log["zzzz"] = np.zeros(N)
    content = bench.write().path.read_bytes()
    assert content.count(b"zzzz") >= 2
    bench.path.write_bytes(content.replace(b"zzzz", b"z\xff\xfez"))
    bench.refused("Parquet")


@case(
    "Files",
    "more rows than fit into memory, even if the file is small",
    "refuse before reading",
    "message with the number of rows, and how many fit",
)
def _(bench):
    rows = 5_000_000
    same = pa.array(np.zeros(rows, dtype=np.float32)).dictionary_encode()
    fields = [pa.field(name, same.type, metadata={"unit": unit}) for name, unit in UNITS.items()]
    pq.write_table(pa.table([same] * len(fields), schema=pa.schema(fields)), bench.path)
    assert bench.path.stat().st_size < 2_000_000  # of 520 MB that it claims to hold
    bench.refused(f"{rows} rows", "memory")


@case("Files", "more than 10 000 columns", "refuse before reading", "message with the number of columns")
def _(bench):
    pq.write_table(pa.table({f"c{k}": [0.0] for k in range(10_001)}), bench.path)
    bench.refused("10001 columns")


@case(
    "Files",
    "a million columns: the footer is larger than 64 MiB",
    "refuse before parsing",
    "message with the size of the footer",
)
def _(bench):
    length = 70 * 2**20
    with bench.path.open("wb") as stream:
        stream.write(b"PAR1")
        stream.seek(4 + length)
        stream.write(length.to_bytes(4, "little") + b"PAR1")
    bench.refused(f"{length} bytes")


# --- outputs -----------------------------------------------------------------------------------------------------------


def refused_to_write(target, word, failure=None):
    """Assert that a file is not written, in one line with a word, and that its folder is as it was."""
    before = sorted(target.parent.iterdir()) if target.parent.is_dir() else None

    def write():
        with replacing(target) as temporary:
            temporary.write_bytes(b"half")
            if failure is not None:
                raise failure

    with pytest.raises(DataError, match=word) as refusal:
        write()
    assert len(str(refusal.value).splitlines()) == 1
    assert before is None or sorted(target.parent.iterdir()) == before


@case("Outputs", "a full disk", "refuse; the old file stays", "message, exit code 3")
def _(bench):
    bench.write()
    refused_to_write(bench.path, "No space left", OSError(28, "No space left on device"))
    assert bench.kept(N)


@case("Outputs", "the output folder is missing or read-only", "refuse before working", "message, exit code 3")
def _(bench):
    refused_to_write(bench.folder / "none" / "result.h5", "cannot be written")
    refused_to_write(Path("/proc/result.h5"), "cannot be written")


@case(
    "Outputs", "a folder, device or pipe in place of the output file", "refuse before working", "message, exit code 3"
)
def _(bench):
    (bench.folder / "result.h5").mkdir()
    refused_to_write(bench.folder / "result.h5", "not a regular file")
    refused_to_write(Path("/dev/null"), "not a regular file")


@case("Outputs", "another process writes the same output file", "refuse before working", "message, exit code 3")
def _(bench):
    lock = bench.folder / ".drive.parquet.lock"
    with lock.open("w") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        refused_to_write(bench.path, "another process")
    bench.write().kept(N)


@case("Outputs", "temporary files of a killed run", "removed by the next run that writes the same file", "nothing")
def _(bench):
    left = [bench.folder / name for name in (".drive.parquet.lock", ".drive.parquet.x1y2z3_4.part")]
    for path in left:
        path.write_bytes(b"half")
    with replacing(bench.path) as temporary:
        temporary.write_bytes(b"whole")
    assert [path.name for path in bench.folder.iterdir()] == ["drive.parquet"]


@case("Outputs", "an output file name that is not UTF-8", "refuse before working", "message, exit code 3")
def _(bench):
    refused_to_write(bench.folder / "r\udcff.h5", "not UTF-8")


# --- no defect ---------------------------------------------------------------------------------------------------------


@case("No defect", "`W_maf` slightly below zero", "kept", "nothing")
def _(bench):
    bench.log["W_maf"][200:400] = -0.004 + 1e-4 * np.sin(np.arange(200.0))
    bench.write().kept(N)


@case("No defect", "ambient pressure and temperature or valve positions that never change", "kept", "nothing")
def _(bench):
    bench.log["u_egr"][:], bench.log["u_vgt"][:] = 0.0, 60.0
    bench.write().kept(N)


@case("No defect", "no channel changes: an engine at idle, or a stationary bench point", "kept", "nothing")
def _(bench):
    for name in bench.log:
        if name != "time":
            bench.log[name][:] = bench.log[name][0]
    bench.write().kept(N)


@case("No defect", "a value repeated between two updates of a slow bus, or coarse resolution", "kept", "nothing")
def _(bench):
    steps = {
        "p_im": 1e3,
        "p_em": 1e3,
        "T_im": 1.0,
        "T_em": 5.0,
        "n_e": 5.0,
        "omega_t": 50.0,
        "u_delta": 0.1,
        "W_maf": 1e-4,
    }
    for name, step in steps.items():
        bench.log[name] = np.repeat(np.round(bench.log[name][::100] / step) * step, 100)
    bench.write().kept(N)


def table():
    """Return docs/defects.md as text."""
    head = [
        "# Defects of logs",
        "",
        "This page lists the known defects of logs and what `lpvobs` does about each. Every row is a test in",
        "`tests/robust/defects.py`; `make defects` writes the tables from there. The column *policy* says what is done:",
        "",
        "- *refuse*: the log is not used, or the output is not written. The command prints one line and ends with exit code 3.",
        "- *drop*: the samples concerned are left out.",
        "- *split*: the log is divided at this place, and the observer starts again with the second part.",
        "- *repair*: the readings are converted as stated, and the log is used.",
        "",
        "The column *shown* says what `lpvobs inspect` prints about the defect. `inspect --json` lists the defects of a used log",
        "under `defects`. A result stores the same list for each of its logs, and `report` prints it. The checks read the log",
        "alone and know nothing of the engine's constants. So they cannot find a wrong unit if every reading is still plausible",
        "with it, for example g/s labelled as kg/h, or a turbine speed in Hz labelled as rad/s.",
    ]
    body = []
    for group in GROUPS:
        body += ["", f"## {group}", "", "| defect | policy | shown |", "|---|---|---|"]
        body += [f"| {item.defect} | {item.policy} | {item.shown} |" for item in CASES if item.group == group]
    return "\n".join([*head, *body]) + "\n"


if __name__ == "__main__":
    (ROOT / "docs" / "defects.md").write_text(table(), encoding="utf-8")
