"""Each row of docs/defects.md holds, and the document is what the cases say."""

import pytest
from repository import ROOT
from robust.defects import CASES, GROUPS, Bench, table

DOCUMENT = ROOT / "docs" / "defects.md"


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.defect[:60])
def test_a_defect_is_treated_as_the_table_says(case, tmp_path):
    case.check(Bench(tmp_path))


def test_the_document_is_what_the_cases_say():
    assert DOCUMENT.read_text(encoding="utf-8") == table(), "stale: run `make defects`"


def test_the_table_is_complete():
    assert len(CASES) >= 40
    assert {case.group for case in CASES} == set(GROUPS)
    assert len({(case.group, case.defect) for case in CASES}) == len(CASES)
