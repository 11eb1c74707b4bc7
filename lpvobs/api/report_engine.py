"""`report ENGINE.h5`: what is known of a calibrated engine, as tables and as a page."""

from pathlib import Path

import h5py

from lpvobs.api.files import File, as_path, writing
from lpvobs.io.configuration.config import config_of
from lpvobs.io.results.engines import KIND, REMEDY, read_engine
from lpvobs.io.results.hdf import is_hdf5, reading
from lpvobs.io.results.provenance import read_provenance
from lpvobs.io.safety.atomic import replacing
from lpvobs.report.engines import CalibrateOutput, told


def is_engine(path: Path) -> bool:
    """Return whether a file says that it is a calibrated engine."""
    if not path.is_file() or not is_hdf5(path):
        return False
    with h5py.File(path, "r") as file:
        return bool(file.attrs.get("schema", "") == f"lpvobs/{KIND}/1")


def report_engine(engine: File, *, html: File | None = None) -> CalibrateOutput:
    """Return what is known of a calibrated engine, and write its page if asked for.

    Raises DataError if the file is no calibrated engine.
    """
    path = as_path(engine)
    with reading(path, KIND, REMEDY) as file:
        text = read_provenance(file).config
    stored = read_engine(path, config_of(text, path).engine_path())
    found = told(stored, str(path))
    if html is not None:
        from lpvobs.report.engine_page import engine_page

        with writing(html, [path]) as target, replacing(target) as temporary:
            temporary.write_text(engine_page(path.name, stored, found), encoding="utf-8")
    return found
