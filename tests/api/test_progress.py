"""Where the progress of a function is seen: by the caller's function, in a notebook as a bar, and nowhere in a script."""

import sys
from types import SimpleNamespace

import pytest
from repository import short_cycle

import lpvobs
from lpvobs.api.files import shown


class Cell:
    """The output of a cell, as IPython's handle on it."""

    def __init__(self):
        self.messages = []

    def update(self, html):
        self.messages.append(html)


@pytest.fixture
def cell(monkeypatch):
    """Return the output of a running cell, of a kernel that stands in for Jupyter's."""
    output = Cell()
    display = SimpleNamespace(HTML=str, display=lambda _, display_id: output if display_id else None)
    notebook = SimpleNamespace(display=display, get_ipython=lambda: SimpleNamespace(kernel=object()))
    monkeypatch.setitem(sys.modules, "IPython", notebook)
    return output


def test_a_notebook_sees_a_bar_that_goes_when_all_is_done(cell):
    tell = shown(None)
    for fraction in (0.0, 0.251, 0.252, 0.6, 1.0):
        tell(fraction)
    assert [message.rpartition("> ")[2] for message in cell.messages] == ["0 %", "25 %", "60 %", ""]


def test_a_function_of_the_caller_comes_first(cell):
    told = []
    shown(told.append)(0.5)
    assert (told, cell.messages) == ([0.5], [])


def test_scripts_and_terminals_see_none(cell, monkeypatch, capsys):
    for get_ipython in (lambda: None, SimpleNamespace):  # IPython loaded but not running, and its terminal
        monkeypatch.setattr(sys.modules["IPython"], "get_ipython", get_ipython)
        shown(None)(0.5)
    monkeypatch.delitem(sys.modules, "IPython")
    shown(None)(0.5)
    assert (cell.messages, capsys.readouterr()) == ([], ("", ""))


def test_a_verb_shows_it(cell, config, tmp_path):
    lpvobs.simulate(config, str(short_cycle(tmp_path)), tmp_path / "drive.parquet", rate=10)
    assert len(cell.messages) > 2
    assert cell.messages[-1] == ""
