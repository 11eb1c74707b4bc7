"""Figures as SVG text that lives inside a page: its colours, its fonts, no identifiers that collide."""

import html
import io
import re
import warnings
from collections import Counter
from collections.abc import Callable
from functools import update_wrapper
from pathlib import Path
from typing import Concatenate, ParamSpec

import matplotlib as mpl
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

P = ParamSpec("P")
Draw = Callable[Concatenate[Figure, P], None]
INK = "#0d0e0f"
"""Stands for the page's text colour while a figure is drawn, so that one figure serves light and dark."""
WIDTH = 7.4  # [inch], of every figure
STYLE = mpl.rc_params_from_file(Path(__file__).with_name("page.mplstyle"), use_default_template=False)
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
TIP = "tip: "  # begins the identifier of an element whose rest is shown when the pointer rests on it
RASTER_DPI = 120  # of the parts that are drawn as images: too dense for lines
MOST_LETTERS = 40  # of a name in a figure; a longer one would leave no room to draw in


class _Power(LogFormatter):
    """Labels of a logarithmic axis as text, where matplotlib writes formulas: 0.02, 10⁻⁵; few of them within a decade."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """Return the label of a value, empty where matplotlib would leave it out."""
        mantissa, exponent = f"{x:.0e}".split("e")
        power = f"{mantissa}·10{str(int(exponent)).translate(RAISED)}".removeprefix("1·")
        plain = f"{x:g}" if 1e-4 < x < 1e6 else power
        return plain if super().__call__(x, pos) else ""


def _without_formulas(figure: Figure) -> None:
    for axis in [axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)]:
        for which in ("major", "minor"):
            if isinstance(old := getattr(axis, f"get_{which}_formatter")(), LogFormatter):
                getattr(axis, f"set_{which}_formatter")(_Power(labelOnlyBase=old.labelOnlyBase))


def drawn(height: float = 4.5) -> Callable[[Draw[P]], Callable[Concatenate[str, str, P], str]]:
    """Turn functions that draw into an empty figure of a height [inch] into such that return it as an `<svg>` element."""
    # Instead of the figure they take its name, of letters, digits and hyphens and unique on the page, and `alt`, which says
    # what the figure shows for those who cannot see it.

    def turned(draw: Draw[P]) -> Callable[Concatenate[str, str, P], str]:
        def as_svg(name: str, alt: str, /, *content: P.args, **options: P.kwargs) -> str:
            stream = io.StringIO()
            with warnings.catch_warnings(), mpl.rc_context(STYLE | {"svg.hashsalt": name}):
                # letters stay letters: the reader's fonts draw them
                warnings.filterwarnings("ignore", "Glyph .* missing from font")
                figure = Figure(figsize=(WIDTH, height), dpi=RASTER_DPI, layout="constrained")
                figure.patch.set_visible(False)
                draw(figure, *content, **options)
                _without_formulas(figure)
                metadata = dict.fromkeys(("Date", "Creator", "Format", "Type"))
                FigureCanvasSVG(figure).print_svg(stream, metadata=metadata)  # type: ignore[no-untyped-call]
            return clean(stream.getvalue(), name, alt)

        return update_wrapper(as_svg, draw)

    return turned


def label_of(name: str) -> str:
    """Return a name as it stands in a figure: on one line, without its middle where it is long.

    Examples
    --------
    >>> label_of("channel:T_coolant")
    'channel:T_coolant'
    >>> len(label_of("long" * 30))
    40
    """
    line = " ".join(name.split())
    half = (MOST_LETTERS - 1) // 2
    return line if len(line) <= MOST_LETTERS else f"{line[: MOST_LETTERS - 1 - half]}…{line[-half:]}"


def clean(text: str, name: str, alt: str) -> str:
    """Return SVG text as matplotlib writes it, made fit for a page: small, without identifiers that others use, too."""
    text = text[text.index("<svg") :]
    text = re.sub(r"<!--.*?-->|<metadata>.*?</metadata>|<style.*?</style>", "", text, flags=re.DOTALL)
    text = re.sub(r' (?:xmlns(?::\w+)?|version|transform)="(?:http[^"]*|1\.1|rotate\(-0 [^"]*)"', "", text)
    text = text.replace("xlink:href", "href")
    text = re.sub(rf'<g id="{TIP}([^"]*)">', r'<g class="tip"><title>\1</title>', text)
    text = re.sub(r'<path [^>]*style="fill: none"\s*/>', "", text)  # no stroke either: paints nothing
    used = set(re.findall(r'(?:url\(#|href="#)([^")]+)', text))  # they differ between figures: the name is their salt
    text = re.sub(r' id="([^"]*)"', lambda found: found[0] if found[1] in used else "", text)
    text = re.sub(r'(?<= d=")[^"]*|(?<= [xy]=")[^"]*', lambda found: _short(found[0]), text)
    text = _classes(text, name)
    text = text.replace("'DejaVu Sans'", "inherit").replace(INK, "currentColor")
    text = re.sub(r">\s+<", "><", text)
    while (less := re.sub(r"<g>((?:(?!</?g[ >]).)*)</g>", r"\1", text, flags=re.DOTALL)) != text:
        text = less  # groups that say nothing of what they hold
    head = re.search(r'viewBox="[^"]*"', text)
    box = head[0] if head else ""
    begin = f'<svg {box} role="img" aria-label="{html.escape(alt)}">'
    return re.sub(r"^<svg[^>]*>", lambda _: begin, text.strip(), count=1)


def _classes(text: str, name: str) -> str:
    """Return the text with styles that it repeats written once."""
    text = re.sub(r' clip-path="([^"]*)" style="', r' style="clip-path: \1; ', text)
    often = [style for style, count in Counter(re.findall(r' style="([^"]*)"', text)).most_common() if count > 2]
    for number, style in enumerate(often):
        text = text.replace(f' style="{style}"', f' class="{name}-{number}"')
    rules = "".join(f".{name}-{number}{{{style}}}" for number, style in enumerate(often))
    return re.sub(r"(^<svg[^>]*>)", lambda found: f"{found[1]}<style>{rules}</style>", text, count=1) if rules else text


def _short(numbers: str) -> str:
    """Return a path with one decimal, less than its line is wide, and no command that says what the one before said."""
    short = re.sub(r"-?\d+\.\d+", lambda found: f"{float(found[0]):.1f}".rstrip("0").rstrip("."), numbers)
    again = r"(?<=L )([^A-Z]*)(?:L ([^A-Z]*))+"
    return re.sub(again, lambda found: found[0].replace("L ", ""), " ".join(short.split()))
