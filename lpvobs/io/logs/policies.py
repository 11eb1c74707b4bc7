"""What to do with the defects of a log, and the account of what was found."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace

from lpvobs.engines.channels import Channel, Pulsation, Sensor
from lpvobs.observer.readings import put_right
from lpvobs.records import Defects, Piece


@dataclass(frozen=True)
class ChannelLimits:
    """Where a working sensor of one engine reads, in the channel's unit; None leaves what holds for the kind of engine."""

    low: float | None = None  # a sample below is a defect
    high: float | None = None  # a sample above is a defect
    typical: tuple[float, float] | None = None  # range in which the median of a whole log lies

    def __post_init__(self) -> None:
        for low, high in ((self.low, self.high), self.typical or (None, None)):
            if low is not None and high is not None and not low < high:
                raise ValueError(f"the lower limit {low:g} must be below the upper limit {high:g}")


@dataclass(frozen=True)
class LogPolicies:
    """What to do with defects; the configuration's `[policies]`."""

    gap_limit: float = 1.0  # [s]; a longer step between samples splits the log into segments
    # `refuse` the log, or `drop` the samples whose time is not later than every earlier one
    backward_time: str = "refuse"
    # of channels of which the configured engine's sensors read elsewhere than those of most of its kind
    limits: Mapping[str, ChannelLimits] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.gap_limit > 0:
            raise ValueError("gap_limit must be positive")
        if self.backward_time not in ("refuse", "drop"):
            raise ValueError("backward_time must be 'refuse' or 'drop'")

    def limited(self, channels: Mapping[str, Channel]) -> dict[str, Channel]:
        """Return channels with the limits that are configured in place of their own."""
        own = {name: {k: v for k, v in asdict(item).items() if v is not None} for name, item in self.limits.items()}
        return {name: replace(channel, **own.get(name, {})) for name, channel in channels.items()}

    def right(self, pieces: Iterable[Piece]) -> Iterable[Piece]:
        """Return readings as recorded."""
        return pieces


@dataclass(frozen=True)
class Reading(LogPolicies):
    """The policies, and what is known of the sensors, for whoever works with what they should have shown."""

    sensors: Mapping[str, Sensor] = field(default_factory=dict)
    narrowest: float = 0.0  # [s], half width of the narrowest window
    pulsation: Pulsation | None = None  # of the engine's air flow sensor

    def right(self, pieces: Iterable[Piece]) -> Iterator[Piece]:
        """Yield readings put right."""
        return put_right(pieces, self.sensors, self.narrowest, self.pulsation)


def together(one: Defects, other: Defects) -> Defects:
    """Return what two parts of a log lost; findings of a kind and channel are counted together, from the first of them on."""
    findings = {(item.kind, item.channel): item for item in one.findings}
    for item in other.findings:
        known = findings.get((item.kind, item.channel), replace(item, samples=0))
        findings[item.kind, item.channel] = replace(known, samples=known.samples + item.samples)
    return Defects(
        one.samples_read + other.samples_read,
        dict(Counter(one.dropped) + Counter(other.dropped)),
        one.dropped_rows + other.dropped_rows,
        one.gaps + other.gaps,
        one.repeated + other.repeated,
        tuple(findings.values()),
    )
