"""Figures as SVG text that lives inside a page: its colours, its fonts, no identifiers that collide."""

import html
import io
import re
from collections.abc import Callable
from typing import Any, cast

import matplotlib as mpl
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

INK = "#0d0e0f"
"""Stands for the page's text colour while a figure is drawn, so that one figure serves light and dark."""
FONT = "DejaVu Sans"
STYLE: dict[str, Any] = {
    "svg.fonttype": "none",
    "font.family": FONT,
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "axes.grid": False,
    "axes.facecolor": "none",  # the page shows through, light or dark
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "grid.alpha": 0.18,
    "grid.linewidth": 0.6,
    "hatch.linewidth": 0.5,
    "lines.linewidth": 1.1,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "path.simplify": False,
} | dict.fromkeys(
    ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color", "grid.color", "hatch.color"), INK
)
RASTER_DPI = 80
"""Of the parts that are drawn as images: too dense for lines."""


def render(name: str, alt: str, size: tuple[float, float], draw: Callable[[Figure], None]) -> str:
    """Return a figure as an `<svg>` element.

    Parameters
    ----------
    name : str
        Letters, digits and hyphens; unique on the page.
    alt : str
        What the figure shows, for those who cannot see it.
    size : tuple of float
        [inch]
    draw : callable
        Draws into an empty figure.
    """
    stream = io.StringIO()
    with mpl.rc_context(cast(Any, STYLE | {"svg.hashsalt": name})):
        figure = Figure(figsize=size, dpi=RASTER_DPI, layout="constrained")
        figure.patch.set_visible(False)
        draw(figure)
        metadata = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        FigureCanvasSVG(figure).print_svg(stream, metadata=metadata)  # type: ignore[no-untyped-call]
    return clean(stream.getvalue(), name, alt)


def clean(text: str, name: str, alt: str) -> str:
    """Return SVG text as matplotlib writes it, made fit for a page: small, without identifiers that others use, too."""
    text = text[text.index("<svg") :]
    text = re.sub(r"<!--.*?-->|<metadata>.*?</metadata>|<style.*?</style>", "", text, flags=re.DOTALL)
    text = re.sub(r' (?:xmlns(?::\w+)?|version|transform)="(?:http[^"]*|1\.1|rotate\(-0 [^"]*)"', "", text)
    text = text.replace("xlink:href", "href")
    text = _local_identifiers(text, name)
    text = re.sub(r'(?<= d=")[^"]*|(?<= [xy]=")[^"]*', lambda found: _short(found[0]), text)
    text = text.replace(f"'{FONT}'", "inherit").replace(INK, "currentColor")
    text = re.sub(r">\s+<", "><", text)
    head = re.search(r'viewBox="[^"]*"', text)
    box = head[0] if head else ""
    return re.sub(
        r"^<svg[^>]*>", lambda _: f'<svg {box} role="img" aria-label="{html.escape(alt)}">', text.strip(), count=1
    )


def _local_identifiers(text: str, name: str) -> str:
    """Return the text with the identifiers that it refers to made the figure's own, and without the others."""
    wanted = set(re.findall(r'(?:url\(#|href="#)([^")]+)', text))

    def identifier(found: re.Match[str]) -> str:
        return f' id="{name}-{found[1]}"' if found[1] in wanted else ""

    text = re.sub(r' id="([^"]*)"', identifier, text)
    return re.sub(r'(url\(#|href="#)', lambda found: f"{found[1]}{name}-", text)


def _short(numbers: str) -> str:
    """Return numbers with two decimals: a hundredth of a point is less than any screen or printer shows."""
    short = re.sub(r"-?\d+\.\d+", lambda found: f"{float(found[0]):.2f}".rstrip("0").rstrip("."), numbers)
    return " ".join(short.split())
