"""Figures as SVG text that lives inside a page: its colours, its fonts, no identifiers that collide."""

import html
import io
import re
import warnings
from collections import Counter
from collections.abc import Callable
from functools import update_wrapper
from typing import Any, Concatenate, ParamSpec, cast

import matplotlib as mpl
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

P = ParamSpec("P")
Draw = Callable[Concatenate[Figure, P], None]
INK = "#0d0e0f"
"""Stands for the page's text colour while a figure is drawn, so that one figure serves light and dark."""
FONT = "DejaVu Sans"
WIDTH = 7.4  # [inch], of every figure
STYLE: dict[str, Any] = {
    "svg.fonttype": "none",
    "text.parse_math": False,  # names of channels may hold dollars
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
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
TIP = "tip: "  # begins the identifier of an element whose rest is shown when the pointer rests on it
RASTER_DPI = 120  # of the parts that are drawn as images: too dense for lines
MOST_LETTERS = 40  # of a name in a figure; a longer one would leave no room to draw in


def render(name: str, alt: str, height: float, draw: Callable[[Figure], None]) -> str:
    """Return a figure of a height [inch] as an `<svg>` element; `draw` draws into an empty figure."""
    # The name, of letters, digits and hyphens, is unique on the page; `alt` says what the figure shows, for those who
    # cannot see it.
    stream = io.StringIO()
    with warnings.catch_warnings(), mpl.rc_context(cast(Any, STYLE | {"svg.hashsalt": name})):
        # letters stay letters: the reader's fonts draw them
        warnings.filterwarnings("ignore", "Glyph .* missing from font")
        figure = Figure(figsize=(WIDTH, height), dpi=RASTER_DPI, layout="constrained")
        figure.patch.set_visible(False)
        draw(figure)
        _without_formulas(figure)
        metadata = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        FigureCanvasSVG(figure).print_svg(stream, metadata=metadata)  # type: ignore[no-untyped-call]
    return clean(stream.getvalue(), name, alt)


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
    """Turn functions that draw into an empty figure of a height [inch] into such that return it as SVG."""
    # Instead of the figure they take the name and what the figure shows, as `render` does.

    def turned(draw: Draw[P]) -> Callable[Concatenate[str, str, P], str]:
        def as_svg(name: str, alt: str, /, *content: P.args, **options: P.kwargs) -> str:
            return render(name, alt, height, lambda figure: draw(figure, *content, **options))

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
    text = _local_identifiers(text, name)
    text = re.sub(r'(?<= d=")[^"]*|(?<= [xy]=")[^"]*', lambda found: _short(found[0]), text)
    text = _classes(text, name)
    text = text.replace(f"'{FONT}'", "inherit").replace(INK, "currentColor")
    text = re.sub(r">\s+<", "><", text)
    while (less := re.sub(r"<g>((?:(?!</?g[ >]).)*)</g>", r"\1", text, flags=re.DOTALL)) != text:
        text = less  # groups that say nothing of what they hold
    head = re.search(r'viewBox="[^"]*"', text)
    box = head[0] if head else ""
    begin = f'<svg {box} role="img" aria-label="{html.escape(alt)}">'
    return re.sub(r"^<svg[^>]*>", lambda _: begin, text.strip(), count=1)


def _local_identifiers(text: str, name: str) -> str:
    """Return the text with the identifiers that it refers to made the figure's own, short, and without the others."""
    wanted = dict.fromkeys(re.findall(r'(?:url\(#|href="#)([^")]+)', text))
    short = {old: f"{name}-i{number}" for number, old in enumerate(wanted)}

    def identifier(found: re.Match[str]) -> str:
        return f' id="{short[found[1]]}"' if found[1] in short else ""

    text = re.sub(r' id="([^"]*)"', identifier, text)
    return re.sub(r'(url\(#|href="#)([^")]+)', lambda found: found[1] + short[found[2]], text)


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
