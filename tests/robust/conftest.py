import pytest
from robust.samples import Samples, make


@pytest.fixture(scope="session")
def samples(tmp_path_factory) -> Samples:
    """Return good files that tests copy before they spoil them."""
    return make(tmp_path_factory.mktemp("samples"))
