"""pyarrow, loaded when something of it is first asked for: a verb that reads no log does without."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__all__ = ["pa", "pc", "pq"]


class _Later:
    """A module that stands for itself until it is needed."""

    def __init__(self, name: str):
        self.name = name

    def __getattr__(self, attribute: str) -> Any:
        return getattr(import_module(self.name), attribute)


if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.parquet as pq
else:
    pa, pc, pq = map(_Later, ("pyarrow", "pyarrow.compute", "pyarrow.parquet"))
