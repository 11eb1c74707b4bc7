"""A small part of `make kill`: SIGKILL at random moments of the quick verbs."""

import pytest
from robust.kill import VERBS, run


@pytest.mark.proof
def test_no_kill_tears_or_loses_a_file():
    hits = run(24, 7, ["estimate", "extrapolate", "export"], lambda line: None)
    assert hits >= 8  # otherwise the verbs had ended before, and nothing was tried


def test_every_verb_that_writes_is_there():
    names = {verb.arguments[0] for verb in VERBS}
    assert names == {
        "simulate", "ingest", "synth-gain", "estimate", "extrapolate", "trace", "refine", "report", "export",
        "profile", "track",
    }  # fmt: skip
