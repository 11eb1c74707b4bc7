"""Texts with places to fill in, which lie beside the code that fills them."""

from collections.abc import Callable, Mapping
from importlib.resources import files
from typing import Any


def filled(package: str, template: str, filters: Mapping[str, Callable[..., Any]], **values: Any) -> str:
    """Return the template `TEMPLATE.j2` of a package with values in its places; `filters` say how it writes some of them."""
    import jinja2  # takes as long to load as many a verb

    environment = jinja2.Environment(
        undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    environment.filters.update(filters)
    return environment.from_string((files(package) / f"{template}.j2").read_text(encoding="utf-8")).render(values)
