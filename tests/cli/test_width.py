"""Tables on a terminal fit its width; through a pipe a row stays a line."""

import os
import pty
import subprocess
from contextlib import suppress

from verbs import AFRESH

from lpvobs.cli.common import table


def on_terminal(columns, *arguments):
    """Return what a terminal of so many columns is sent."""
    ours, theirs = pty.openpty()
    call = [*AFRESH, *map(str, arguments)]
    environment = os.environ | {"COLUMNS": str(columns)}
    with subprocess.Popen(
        call, stdout=theirs, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, env=environment
    ) as process:
        os.close(theirs)
        parts = []
        with suppress(OSError):  # EIO is how Linux says that the other end has closed
            while part := os.read(ours, 65536):
                parts.append(part)
        assert process.wait(timeout=300) == 0, process.stderr.read()
    os.close(ours)
    return b"".join(parts).decode().replace("\r\n", "\n")


def test_a_wide_table_goes_on_below(lpvobs, chain):
    piped = lpvobs("report", chain.result).out
    shown = on_terminal(80, "report", chain.result)
    table = piped.split("\n\n")[0]
    assert max(map(len, table.splitlines())) > 80
    parts = [part.splitlines() for part in shown.split("\n\n") if part.startswith("result ")]
    assert len(parts) > 1
    assert max(len(line) for part in parts for line in part) <= 80
    heads, rows = ([part[line] for part in parts] for line in (0, 1))
    assert all(row.startswith("result  observer  FTP75 cold transient") for row in rows)
    # every cell is there, in its order, once
    labels = len(table.splitlines()[0].split("log")[0]) + 3
    for whole, parted in ((table.splitlines()[0], heads), (table.splitlines()[1], rows)):
        assert " ".join(part[labels:] for part in parted).split() == whole[labels:].split()


def test_a_table_that_fits_stays_whole(lpvobs, chain):
    assert on_terminal(400, "report", chain.result) == lpvobs("report", chain.result).out


def test_names_of_files_cannot_command_the_terminal(lpvobs, tmp_path):
    """A channel or a file may be called anything, an escape sequence or a second line as well."""
    done = lpvobs("inspect", tmp_path / "clear\x1b[2J\u202eyes.parquet")
    assert done.code == 3
    assert "clear\ufffd[2J\ufffdyes.parquet" in done.err
    assert len(table(["channel"], [["one\ntwo"]]).splitlines()) == 2
