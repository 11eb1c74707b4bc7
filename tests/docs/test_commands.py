"""What README and tutorial tell a reader to type is typed here, in order, and prints what they show."""

import shutil
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from docs.documents import commands, missing, prepare, run, same_line, without_set_up
from repository import ROOT


def recording(folder: Path) -> None:
    """Write the drive as a measurement system would have it in MDF4, with the names and units of the log."""
    asammdf = pytest.importorskip("asammdf")
    log = pq.read_table(folder / "drive.parquet")
    time = log["time"].to_numpy()
    signals = [
        asammdf.Signal(log[field.name].to_numpy(), time, unit=field.metadata[b"unit"].decode(), name=field.name)
        for field in log.schema
        if field.name != "time" and not field.name.startswith("ref_")
    ]
    with asammdf.MDF(version="4.10") as file:
        file.append(signals, common_timebase=True)
        file.save(folder / "drive.mf4")


def fleet(folder: Path) -> None:
    """Lay two drives into two folders."""
    for place, name, source in (("logs", "monday", "drive"), ("more", "tuesday", "other_drive")):
        (folder / place).mkdir()
        shutil.copy(folder / f"{source}.parquet", folder / place / f"{name}.parquet")


PAGES = ("README.md", "docs/tutorial.md", "docs/own-engine.md", "docs/control-unit.md", "docs/fleet.md")
GIVEN = {"drive.mf4": recording, "logs/ more/": fleet}
"""What a page takes as there, and who puts it there before the first block that names it."""


@pytest.mark.proof
@pytest.mark.parametrize("page", PAGES)
def test_the_commands_of_a_page_print_what_it_shows(page, tmp_path):
    environment = prepare(tmp_path)
    ready = set()
    for block, shown in commands(ROOT / page):
        text = without_set_up(block.text)
        for name, put in GIVEN.items():
            if name in text and name not in ready:
                put(tmp_path)
                ready.add(name)
        printed = run(text, tmp_path, environment) if text.strip() else ""
        if shown is not None:
            lacking = missing(shown.text, printed)
            assert not lacking, f"{page}, line {shown.line}: does not print\n{lacking}\nbut\n{printed}"


def test_every_verb_is_shown_at_work():
    text = "\n".join(without_set_up(block.text) for page in PAGES for block, _ in commands(ROOT / page))
    verbs = (
        "simulate calibrate ingest profile inspect synth-gain verify estimate extrapolate trace refine export track "
        "report selftest"
    )
    assert [verb for verb in verbs.split() if f"lpvobs {verb}" not in text] == []


@pytest.mark.parametrize("page", sorted(path.name for path in (ROOT / "docs").glob("*.md")))
def test_every_page_is_in_the_navigation(page):
    assert f": {page}\n" in (ROOT / "mkdocs.yml").read_text(encoding="utf-8")


def test_every_room_is_in_the_reference():
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    inside = (ROOT / "lpvobs").iterdir()
    rooms = {path.stem for path in inside if path.suffix == ".py" or (path / "__init__.py").exists()}
    rooms -= {"__init__", "__main__", "cli"}
    assert {path.stem for path in (ROOT / "docs" / "reference").glob("*.md")} == rooms | {"verbs"}
    assert all(f": reference/{room}.md\n" in navigation for room in rooms)


@pytest.mark.parametrize(
    ("shown", "printed", "same"),
    [
        ("found  20.0 mm^2", "found 20.1 mm^2", True),
        ("found 20.0 mm^2", "found 22.0 mm^2", False),
        ("found 20.0 mm^2", "found 20.0 cm^2", False),
        ("bias 0.004 g/s", "bias 0.005 g/s", True),  # a unit of the last decimal
        ("bias 0.004 g/s", "bias 0.009 g/s", False),
        ("154 of 255 nodes", "153 of 255 nodes", True),
        ("54 of 255 nodes", "45 of 255 nodes", False),
        ("made of a.csv (sha256 12...)", "made of a.csv (sha256 12fe01)", True),
        ("verdict: none", "verdict: effect", False),
        ("1.5e-06", "1.5e-05", False),
    ],
)
def test_what_counts_as_the_same(shown, printed, same):
    assert same_line(shown, printed) is same


@pytest.mark.parametrize(
    ("shown", "lacking"),
    [
        ("a\nb\nc\n", ""),
        ("a\n...\nc", ""),
        ("...\nb\n...", ""),
        ("a\nc", "c"),
        ("a\nb", "(not shown) c"),
        ("...\nd\n...", "d"),
        ("...\nc\n...\nb", "b"),
    ],
)
def test_what_is_left_out_is_said(shown, lacking):
    assert missing(shown, "a\nb\n\nc\n") == lacking
