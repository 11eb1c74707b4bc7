"""The verdicts of gates as JUnit XML, which CI systems show test by test."""

import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

from lpvobs.io.safety.atomic import replacing
from lpvobs.report.gates import Verdict

_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""What XML 1.0 cannot hold, not even escaped; names of files may."""


def write_junit(path: Path, verdicts: Sequence[Verdict]) -> None:
    """Write one suite per result and one test case per log and gate; the file appears whole or not at all.

    A log that fails a gate is a `failure`, one that cannot have the metric an `error`. Same verdicts, same bytes: there are no
    time stamps.
    """
    with replacing(path) as temporary:
        temporary.write_bytes(junit_xml(verdicts))


def junit_xml(verdicts: Sequence[Verdict]) -> bytes:
    """Return the document, UTF-8."""
    root = ElementTree.Element("testsuites", {"name": "lpvobs", **_counts(verdicts)})
    for result in dict.fromkeys(item.result for item in verdicts):
        own = [item for item in verdicts if item.result == result]
        suite = ElementTree.SubElement(root, "testsuite", {"name": _text(result), **_counts(own)})
        for item in own:
            _add_case(suite, item)
    ElementTree.indent(root)
    written: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return written + b"\n"


def _counts(verdicts: Sequence[Verdict]) -> dict[str, str]:
    missing = sum(item.value is None for item in verdicts)
    failed = sum(not item.holds for item in verdicts) - missing
    return {"tests": str(len(verdicts)), "failures": str(failed), "errors": str(missing)}


def _add_case(suite: ElementTree.Element, verdict: Verdict) -> None:
    name = {"classname": _text(verdict.result), "name": _text(f"{verdict.log}: {verdict.gate}"), "time": "0"}
    case = ElementTree.SubElement(suite, "testcase", name)
    if verdict.value is None:
        ElementTree.SubElement(case, "error", {"type": "no such metric", "message": _text(str(verdict))})
    elif verdict.holds:
        ElementTree.SubElement(case, "system-out").text = _text(str(verdict))
    else:
        ElementTree.SubElement(case, "failure", {"type": "gate", "message": _text(str(verdict))})


def _text(text: str) -> str:
    return _NOT_XML.sub("\ufffd", text)
