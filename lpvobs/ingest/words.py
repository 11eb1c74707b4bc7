"""What the words of a channel's name mean, in whatever language or control unit's shorthand they are written."""

import re
import tomllib
import unicodedata
from functools import cache
from importlib.resources import files

OPTIONAL = frozenset({"engine", "actual", "absolute", "air", "gas"})  # words without which a name means the same
LETTERS = "ptnq"  # letters of a quantity that stand before a word without a gap, as in `pAmb`
_SECOND = re.compile(r"(?<!\d)(?<!can)(?<!o)[2-9](?!\d)", re.IGNORECASE)
"""The number of what there are several of, and what is not the first of them."""
_UMLAUTS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss", "Ä": "Ae", "Ö": "Oe", "Ü": "Ue"})


def bare(name: str) -> str:
    """Return a name without what measurement systems add: device, raster, index, number of the parameter.

    Examples
    --------
    >>> bare("AFS_dm" + chr(92) + "XCP:1"), bare("LSU_rLam_[0]"), bare("EnvP_p@CCP"), bare("SPN 190 - Engine Speed")
    ('AFS_dm', 'LSU_rLam', 'EnvP_p', 'Engine Speed')
    """
    text = re.sub(r"([\\@;][^\\]*|_?\[\d+\]|_\d+ms|\.(MCD|UserAvg|Avg))+$", "", name.strip(), flags=re.IGNORECASE)
    text = text.replace("(from vehicle)", "").strip()  # Torque
    number = r"^((S\d_)?(SPN|PR|PID|IDE|MAS|0x)[ _:]?[0-9A-F]{2,5}|\[?0x[0-9A-F]{2}\]?|\d{1,3} ?[-:])[ _:-]+(?=\D)"
    return re.sub(number, "", text)


def normalised(name: str) -> str:
    """Return a name in lower-case words.

    Examples
    --------
    >>> normalised("EngineSpeed_filt"), normalised("meas.p_im"), normalised("W_maf")
    ('engine speed filt', 'p im', 'w maf')
    """
    last = re.split(r"[.:](?=\w)", bare(name))[-1]
    split = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=\d)(?=[A-Z][a-z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", last)
    words = " ".join(re.sub(r"[\W_]+", " ", split.lower()).split())
    return re.sub(r"^(s\d+ )?pid [0-9a-f]{2} | g\d{2,3}$", "", words)


@cache
def meanings(name: str) -> tuple[frozenset[str], ...]:
    """Return what the words of a name mean: of its last part, its last two, ...; a question mark is before one unknown.

    Examples
    --------
    >>> [sorted(words) for words in meanings("ECM.Saugrohrdruck")]
    [['intake', 'manifold', 'pressure']]
    >>> [sorted(words) for words in meanings("EngBlob1Press")]
    [['?blob', 'engine', 'pressure']]
    """
    parts = [_words(part) for part in re.split(r"[./](?=\w)|:+(?=\w)", bare(name))]
    joined = (frozenset().union(*parts[first:]) for first in range(len(parts) - 1, -1, -1))
    return tuple(dict.fromkeys(_alone(words) for words in joined))


def _alone(words: frozenset[str]) -> frozenset[str]:
    """Return words without those that only explain another: the gas that is recirculated, the turbo whose vanes move."""
    if "egr" in words:
        words -= {"exhaust", "gas"}
    return words - {"turbo"} if "vgt" in words else words


def _words(text: str) -> frozenset[str]:
    plain = unicodedata.normalize("NFKD", text.translate(_UMLAUTS)).encode("ascii", "ignore").decode()
    split = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", plain).lower()
    split = re.sub(r"(?<![a-z])((?:c|n)?o ?2|[a-z]+)|(\d+)", lambda found: f" {found[1] or ''} ", split)
    second = ["second"] if _SECOND.search(plain) else []
    return frozenset([*second, *(word for part in re.findall(r"[a-z]+2?", split) for word in _of(part))])


def _of(word: str) -> list[str]:
    """Return what a word means: one of the vocabulary, a compound of such, or one behind a letter."""
    if (found := _known(word)) is not None:
        return found
    ways = [way for way in (_compound(word), _halves(word), _behind_a_letter(word)) if way]
    return next((way for way in ways if not any(part[0] == "?" for part in way)), [*ways, ["?" + word]][0])


def _compound(word: str) -> list[str]:
    for stem, means in _vocabulary()[1]:
        if len(word) > 4 and (part := stem.search(word)):
            rest = (word[: part.start()], word[part.end() :])
            return [*means, *(found for piece in rest if len(piece) > 2 for found in _of(piece))]
    return []


def _halves(word: str) -> list[str]:
    halves = ((_known(word[:cut]), _known(word[cut:])) for cut in range(2, len(word) - 1))
    return next(([*one, *other] for one, other in halves if one and other), [])


def _behind_a_letter(word: str) -> list[str]:
    rest = _known(word[1:])
    return [*(_known(word[0]) or []), *rest] if rest and word[0] in LETTERS else []


def _known(word: str) -> list[str] | None:
    return next((means for spellings, means in _vocabulary()[0] if spellings.fullmatch(word)), None)


@cache
def _vocabulary() -> tuple[list[tuple[re.Pattern[str], list[str]]], ...]:
    """Return spellings of words and of parts of compounds, with what they mean."""
    tables = tomllib.loads(files("lpvobs.ingest").joinpath("words.toml").read_text(encoding="utf-8"))
    return tuple(
        [(re.compile(spellings), means.split()) for means, spellings in tables[kind].items()]
        for kind in ("words", "stems")
    )


def fits(phrases: str, words: frozenset[str], whole: bool) -> bool:
    """Return whether words hold one of the phrases, `a b, c -d`, and none of what it excludes; `whole`: nothing beside it."""
    for phrase in phrases.split(","):
        wanted = {word for word in phrase.split() if word[0] != "-"}
        barred = {word[1:] for word in phrase.split() if word[0] == "-"}
        if wanted and wanted <= words and not barred & words and not (whole and words - wanted - OPTIONAL):
            return True
    return False
