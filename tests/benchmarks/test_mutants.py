"""The list of mutants that do what the original does names what is in the code."""

import importlib.util

from repository import ROOT


def test_every_mutant_of_the_list_is_one_of_the_code(monkeypatch):
    folder = ROOT / "benchmarks" / "mutants"
    monkeypatch.syspath_prepend(str(folder))
    spec = importlib.util.spec_from_file_location("mutants_of_the_core", folder / "__main__.py")
    bench = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(bench)
    everything = {room: [m for module in bench.modules(room) for m in bench.mutants(module)] for room in bench.ROOMS}
    assert set(bench.reasons(everything).values())  # it ends where an entry names nothing
