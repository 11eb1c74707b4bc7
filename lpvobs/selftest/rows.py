"""A check with its answer: what was expected, what came out, how far apart they may lie."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    case: str  # what is examined
    basis: str  # where the answer comes from
    expected: float  # in `unit`, like `found`; yes and no are one and zero
    found: float
    tolerance: float  # largest difference that passes
    unit: str = "1"
    note: str = ""  # what went wrong, where no number came out at all

    @property
    def passed(self) -> bool:
        """Whether the answer is right; what is not a number never is."""
        return abs(self.found - self.expected) <= self.tolerance


@dataclass(frozen=True, kw_only=True)
class CaseOutput:
    """A case with a known answer."""

    case: str
    basis: str
    expected: float
    found: float
    tolerance: float
    unit: str
    note: str
    passed: bool


@dataclass(frozen=True, kw_only=True)
class SelftestOutput:
    """Cases with known answers."""

    passed: bool
    cases: Sequence[CaseOutput]
    versions: Mapping[str, str]


Case = Callable[[], Iterable[Row]]


def rows_of(name: str, case: Case) -> Iterator[Row]:
    """Yield the rows of a case; one that fails where it stands if the case ends in an exception."""
    try:
        yield from case()
    except Exception as error:  # whatever is broken in the installation belongs into the table
        note = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        yield Row(name, "runs at all", 1.0, 0.0, 0.0, note=note)
