"""Recordings of real engines: not part of the project, read where the environment says they are."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def measured() -> Path:
    """Return the folder of measured recordings; without it the test is skipped, and says so."""
    named = os.environ.get("LPVOBS_MEASURED_DIR", "")
    if not named:
        pytest.skip("LPVOBS_MEASURED_DIR is not set: no measured recordings to read")
    folder = Path(named)
    assert folder.is_dir(), f"LPVOBS_MEASURED_DIR={named} is no folder"
    return folder
