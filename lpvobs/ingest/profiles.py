"""Profiles: TOML files that say how a foreign recording becomes a log."""

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from lpvobs.engines.registry import usual_engine
from lpvobs.errors import UsageError
from lpvobs.ingest.computed import Computed
from lpvobs.ingest.record import ProfileDone
from lpvobs.io.configuration.strict import convert, parse, read_text
from lpvobs.simulation.cycles import shipped_folder

SCHEMA = 1
RULES = ("hold", "linear", "mean")
FORMATS = ("csv", "parquet", "mat", "mdf")
EXAMPLE = "configs/profiles/kit-obd.toml"


@dataclass(frozen=True)
class SourceRules:
    """How the file is laid out; the profile's `[source]`."""

    format: str = ""  # `csv`, `parquet`, `mat` or `mdf`; empty: by what the file's first bytes are
    encoding: str = "utf-8"  # of a CSV file
    delimiter: str = ","  # of a CSV file
    decimal: str = "."  # the same
    header_row: int = 1  # line of a CSV file that holds the names, counted from 1
    unit_row: int = 0  # line that holds the units; 0: no such line
    # each row refreshes one column, in turn, and repeats the others: only the refreshed value is a sample
    polled: bool = False

    def __post_init__(self) -> None:
        if self.format and self.format not in FORMATS:
            raise ValueError(f"format must be one of {', '.join(FORMATS)}")
        if len(self.delimiter) != 1 or (not self.delimiter.isprintable() and self.delimiter != "\t"):
            raise ValueError("delimiter must be one character")
        if self.decimal not in (".", ",") or self.decimal == self.delimiter:
            raise ValueError("decimal must be '.' or ',' and not the delimiter")
        if not 1 <= self.header_row <= 1000 or not 0 <= self.unit_row <= 1000 or self.unit_row == self.header_row:
            raise ValueError(
                "header_row and unit_row must be different lines from 1 to 1000; unit_row = 0 means that no line has units"
            )


@dataclass(frozen=True)
class TimeRules:
    """Where time comes from; the profile's `[time]`."""

    source: str = ""  # Column or variable. Not for MDF, whose channels have their own.
    # a unit of time, `clock` for a time of day as text (h:mm:ss.sss), or `datetime` for ISO 8601; empty: what the file
    # says
    unit: str = ""
    from_zero: bool = False  # let the log start at 0 s
    backward: str = "refuse"  # `refuse`, or `drop` the samples whose time is not later than every earlier one

    def __post_init__(self) -> None:
        if self.backward not in ("refuse", "drop"):
            raise ValueError("backward must be 'refuse' or 'drop'")


@dataclass(frozen=True)
class Raster:
    """The samples of the log; the profile's `[raster]`."""

    rate: float = 0.0  # [Hz]; 0: the samples stay where they were recorded, which needs one time base for all channels
    gap: float = 1.0  # [s]; where no channel at all has a sample for longer, the log has none either

    def __post_init__(self) -> None:
        if not (0 <= self.rate <= 1e5 and 0 < self.gap < math.inf):
            raise ValueError("rate must be from 0 to 100000 Hz, and gap must be positive")


@dataclass(frozen=True)
class ChannelRules:
    """Where one channel of the log comes from, and what is done to it; a table of the profile's `[channels]`."""

    # name in the file, with or without the unit that its header has in brackets; of several, the first that is there
    source: str | list[str]
    unit: str  # unit in the log
    source_unit: str = ""  # unit in the file; empty: what the file says
    time: str = ""  # its own time column or variable; empty: that of `[time]`
    # How it comes to the raster: `hold` the last sample, `linear` between neighbours, `mean` of the interpolated signal
    # over one raster step (also the anti-alias filter). Empty: as recorded; with a rate, `mean` if the channel is
    # faster than the raster and `linear` if not.
    rule: str = ""
    # [s]; no sample is held, and no pair of neighbours bridged, for longer. 0: the raster's gap, or 2.5 usual steps of
    # the channel if that is longer.
    limit: float = 0.0
    scale: float = 1.0  # repairs in the file's unit: value = scale * recorded + offset; -1 turns a sign
    offset: float = 0.0
    low: float = -math.inf  # [unit in the log]; what is below is not a reading of a working sensor, and removed
    high: float = math.inf  # [unit in the log]; what is above is none either
    invalid: list[float] = field(default_factory=list)  # recorded numbers that mean "no value"
    optional: bool = False  # the log may lack it
    meaning: str = ""  # for people

    def __post_init__(self) -> None:
        if not self.names or not all(self.names):
            raise ValueError("source must name at least one column")
        if self.rule and self.rule not in RULES:
            raise ValueError(f"rule must be one of {', '.join(RULES)}")
        if not 0 <= self.limit < math.inf:
            raise ValueError("limit must be zero or positive")
        if not (math.isfinite(self.scale) and self.scale != 0 and math.isfinite(self.offset)):
            raise ValueError("scale must be finite and not zero, and offset must be finite")
        if not self.low < self.high:
            raise ValueError("low must be below high")

    @property
    def names(self) -> list[str]:
        """Return the names to look for, in order."""
        return [self.source] if isinstance(self.source, str) else self.source


@dataclass(frozen=True)
class Profile:
    """How one kind of foreign recording becomes a log; see the profiles that are shipped for what every key means."""

    schema: int
    channels: Mapping[str, ChannelRules]
    description: str = ""
    source: SourceRules = field(default_factory=SourceRules)
    time: TimeRules = field(default_factory=TimeRules)
    raster: Raster = field(default_factory=Raster)
    computed: Mapping[str, Computed] = field(default_factory=dict)  # from the channels, in order


def shipped() -> dict[str, Path]:
    """Return the profiles that come with the package, by name."""
    return {path.stem: path for path in sorted((shipped_folder("configs") / "profiles").glob("*.toml"))}


def load_profile(name: str) -> tuple[Profile, ProfileDone]:
    """Return a shipped profile by name, or one by its path, and what a log keeps of it; raises UsageError for none."""
    known = shipped()
    path = known.get(name, Path(name))
    if name not in known and path.suffix != ".toml" and not path.exists():
        raise UsageError(
            f"--profile {name}: no such profile; lpvobs has the profiles {', '.join(known)}; name one of them or your own TOML file"
        )
    text = read_text(path)
    digest = hashlib.sha256(text.encode()).hexdigest()
    return profile_of(text, path), ProfileDone(path.stem, digest, text)


def profile_of(text: str, path: Path) -> Profile:
    """Return the profile in a text; `path` names it in errors."""
    profile = convert(path, parse(text, path), Profile, EXAMPLE)
    if profile.schema != SCHEMA:
        raise UsageError(
            f"{path}: schema = {profile.schema}, expected {SCHEMA}; this file is for another version of lpvobs"
        )
    if not profile.channels:
        sensor = usual_engine().air_path.sensor
        raise UsageError(f"{path}: [channels] is empty; give at least one table such as [channels.{sensor}]")
    units = {name: rules.unit for name, rules in profile.channels.items()}
    for name, item in profile.computed.items():
        try:
            if name in units:
                raise ValueError("a channel in [channels] has this name as well; rename one of the two")
            item.checked(units)
        except ValueError as error:
            raise UsageError(f"{path}: computed.{name}: {error}") from None
        units[name] = item.unit
    for name in units:
        if name == "time" or name.startswith("ref_"):
            raise UsageError(
                f"{path}: {name}: a channel cannot have this name; time has its own table [time], and names that "
                "begin with ref_ are reserved for true values"
            )
    return profile
