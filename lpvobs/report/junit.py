"""Verdicts of gates as JUnit XML, which CI systems show."""

import re
from collections.abc import Sequence
from pathlib import Path

import jinja2

from lpvobs.io.safety.atomic import replacing
from lpvobs.report.gates import Verdict

_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""What XML 1.0 cannot hold, not even escaped; names of files may."""


def write_junit(path: Path, verdicts: Sequence[Verdict], refused: Sequence[str] = ()) -> None:
    """Write one suite per result and one test case per log and gate; the file appears whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_bytes(junit_xml(verdicts, refused))


def junit_xml(verdicts: Sequence[Verdict], refused: Sequence[str] = ()) -> bytes:
    """Return the document, UTF-8."""
    loader = jinja2.PackageLoader("lpvobs.report")
    environment = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    text = environment.get_template("junit.xml.j2").render(verdicts=verdicts, refused=refused)
    return _NOT_XML.sub("\ufffd", text).encode() + b"\n"
