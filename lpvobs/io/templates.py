"""Texts with places to fill in, which lie beside the code that fills them."""

from collections.abc import Callable
from importlib.resources import files
from typing import Any


def filled(package: str, name: str, filters: dict[str, Callable[..., str]], **values: Any) -> str:
    """Return the template `NAME.j2` of a package with values in its places; `filters` say how it writes some of them."""
    import jinja2  # takes as long to load as many a verb

    environment = jinja2.Environment(
        undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    environment.filters |= filters
    return environment.from_string((files(package) / f"{name}.j2").read_text(encoding="utf-8")).render(values)
