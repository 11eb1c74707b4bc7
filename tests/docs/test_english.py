"""Sentences that people read are short, begin with their subject, and use words that people use: help, messages, pages, reports.

A sentence that a colleague would not say is easier to write than to notice. This finds the usual ways: too long, turned
round (`Of 30 pairs 12 were found`), and words that only this project used.
"""

import ast
import re
from functools import cache

import pytest
from repository import ROOT

LONGEST = {"page": 40, "help": 30, "message": 35}
"""Words of a sentence; whoever reads a longer one aloud runs out of breath. A message names file, place, expectation and remedy."""
ERRORS = ("UsageError", "DataError", "NotProven", "say", "fail")
HELP = ("option", "needed", "argument", "flag")
TURNED = re.compile(r"^(Of|Among) [^.]{0,80}\d|^(Of|Among) [^,]{0,60}, (none|some|all|one)\b")
PRIVATE = re.compile(
    r"\b(anew|whoever|of before|see to (it|its|the|that)\b|told to nobody|aught|thereof|forthwith)", re.IGNORECASE
)
NO_SENTENCES = r"```.*?```|^\|[^\n]*$|^--8<--[^\n]*$|\$\$.*?\$\$"
MARKUP = re.compile(r"\$\$.*?\$\$|\$[^$]*\$|\]\([^)]*\)|[*\[]", re.DOTALL)


def text_of(node):
    """Return the text of a literal, each inserted value as one word; None for anything else."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else None
    if isinstance(node, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else "X" for part in node.values)
    if isinstance(node, ast.BinOp):
        parts = text_of(node.left), text_of(node.right)
        return "".join(part or "X" for part in parts) if any(parts) else None
    return None


def from_sources():
    """Yield the place, kind and text of every help and message in the package."""
    for path in sorted((ROOT / "lpvobs").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            name = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
            said = (
                node.args
                if name in ERRORS + HELP
                else [node.value]
                if isinstance(node, ast.Yield) and node.value
                else ()
            )
            for text in map(text_of, said):
                if text and " " in text:
                    yield f"{path.name}:{node.lineno}", "help" if name in HELP else "message", text
            if isinstance(node, ast.FunctionDef) and any(ast.unparse(d) == "guarded" for d in node.decorator_list):
                yield f"{path.name}:{node.lineno}", "help", ast.get_docstring(node).partition("Example:")[0]


def from_pages():
    """Yield the place, kind and text of every paragraph of README and pages."""
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        text = re.sub(NO_SENTENCES, "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
        for paragraph in re.split(r"\n\s*\n|^\s*[-*] |^\d+\. |^#.*$", text, flags=re.MULTILINE):
            yield path.name, "page", paragraph


def from_reports():
    """Yield the place, kind and text of every paragraph that stands in the HTML pages of `report`."""
    for path in sorted((ROOT / "lpvobs" / "report" / "templates").glob("*.j2")):
        text = path.read_text(encoding="utf-8")
        captions = re.findall(r"{% call figure\(.*?%}(.*?){% endcall %}", text, flags=re.DOTALL)
        for paragraph in (*re.findall(r"<(?:p|li)\b[^>]*>(.*?)</(?:p|li)>", text, flags=re.DOTALL), *captions):
            yield (
                path.name,
                "page",
                re.sub(r"\{%.*?%\}|<[^>]*>", "", re.sub(r"\{\{.*?\}\}", "X", paragraph), flags=re.DOTALL),
            )


@cache
def sentences():
    """Return place, kind and words of every sentence."""
    found = []
    for place, kind, text in (*from_sources(), *from_pages(), *from_reports()):
        whole = " ".join(MARKUP.sub(" ", text).split())
        for sentence in re.split(r"(?<=[.!?])\s+(?=[A-Z`0-9])", whole):
            found.append((place, kind, sentence))
    return found


def test_there_is_something_to_read():
    assert {kind: sum(own == kind for _, own, _ in sentences()) > 80 for kind in LONGEST} == dict.fromkeys(
        LONGEST, True
    )


@pytest.mark.parametrize("kind", LONGEST)
def test_no_sentence_is_too_long(kind):
    most = LONGEST[kind]
    assert [
        (place, sentence) for place, own, sentence in sentences() if own == kind and len(sentence.split()) > most
    ] == []


def test_no_sentence_is_turned_round():
    assert [(place, sentence) for place, _, sentence in sentences() if TURNED.search(sentence)] == []
    assert TURNED.search("Of pairs 30 of 38 were found whole.")
    assert not TURNED.search("Both effects were found in 30 of 38 drives with two.")


def test_no_word_is_private():
    assert [(place, sentence) for place, _, sentence in sentences() if PRIVATE.search(sentence)] == []
