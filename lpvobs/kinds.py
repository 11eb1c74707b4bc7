"""Kinds of values in the records that are printed as JSON: what their schemas say of them beyond the type.

A `float` may be NaN, which is printed as null; a `Finite` may not.
"""

from collections.abc import Sequence
from typing import Annotated

from msgspec import Meta

Count = Annotated[int, Meta(ge=0)]
Finite = Annotated[float, Meta(extra_json_schema={"finite": True})]
Seconds = Annotated[Finite, Meta(description="s")]
Fraction = Annotated[float | None, Meta(description="Fraction, not percent: 0.02 means 2 %.")]
KgPerS = Annotated[float, Meta(description="kg/s")]
Sha = Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
Refused = Annotated[Sequence[str], Meta(description="Logs that were left out, each with the reason.")]
