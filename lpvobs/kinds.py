"""Records that are printed as JSON, and kinds of values in them: what their schemas say of them beyond the type.

A `float` may be NaN, which is printed as null; a `Finite` may not.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, dataclass_transform

from msgspec import Meta

Count = Annotated[int, Meta(ge=0)]
Finite = Annotated[float, Meta(extra_json_schema={"finite": True})]
Seconds = Annotated[Finite, Meta(description="s")]
Fraction = Annotated[float | None, Meta(description="Fraction, not percent: 0.02 means 2 %.")]
KgPerS = Annotated[float, Meta(description="kg/s")]
Sha = Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
Refused = Annotated[Sequence[str], Meta(description="Logs that were left out, each with the reason.")]


@dataclass_transform(kw_only_default=True, frozen_default=True)
class Output:
    """A record that is printed as JSON: each is a frozen dataclass, made with the names of its fields."""

    def __init_subclass__(cls) -> None:
        """Make the record a dataclass."""
        dataclass(frozen=True, kw_only=True)(cls)
