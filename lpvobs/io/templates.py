"""Texts with places to fill in, which lie beside the code that fills them."""

from collections.abc import Callable, Mapping
from typing import Any


def filled(
    package: str, template: str, filters: Mapping[str, Callable[..., Any]], markup: bool = False, **values: Any
) -> str:
    """Return the template `TEMPLATE.j2` of a package with values in its places; `filters` say how it writes some of them.

    In `markup` values are escaped, and the last line does not end; the templates that a template uses know the values, too.
    """
    import jinja2  # takes as long to load as many a verb

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader(package, ""),
        autoescape=markup,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=not markup,
    )
    environment.filters.update(filters)
    environment.globals.update(values)
    return environment.get_template(f"{template}.j2").render()
