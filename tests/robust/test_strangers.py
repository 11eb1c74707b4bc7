"""Strings from files end in the page as text, never as markup; no reader runs what a file says."""

import ast
import html.parser
import os
import shutil
import subprocess
import sys
from importlib import resources

import h5py
import pytest
from repository import DIESEL, ROOT
from robust.defects import Bench
from robust.samples import lenient

from lpvobs.api.estimate import estimate
from lpvobs.api.extrapolate import extrapolate
from lpvobs.errors import UsageError
from lpvobs.io.configuration.config import load_config
from lpvobs.io.results.hdf import changing
from lpvobs.report.content import load
from lpvobs.report.page import page

EVIL = "<img src=x onerror=alert(1)>\"'&<script>alert(2)<\u0338script>]]>"
CONTROLS = "\x1b[2J\x07\u202e"  # a terminal or a browser would obey them; TOML does not take them


@pytest.fixture(scope="module")
def hostile(samples, tmp_path_factory):
    """Return a result and its log whose names and texts are markup, wherever a stranger can put a string."""
    folder = tmp_path_factory.mktemp("hostile")
    bench = Bench(folder)
    bench.log[EVIL] = bench.log["n_e"]
    bench.units[EVIL] = EVIL
    bench.write()
    log, result = folder / f"{EVIL[:28]}.parquet", folder / "<b onmouseover=alert(3)>.h5"
    shutil.move(bench.path, log)
    estimate(lenient(folder, f"# {EVIL}\n"), log, result, gain=samples.gain, method="batch")
    extrapolate(result)
    with changing(result, result) as file:
        file["provenance"].attrs["command_line"] = EVIL + CONTROLS
        file["provenance"].attrs["versions"] = '{"<u>numpy</u>": "<script>alert(4)</script>"}'
        file["gain"].attrs["origin"] = EVIL + CONTROLS
        file.attrs["method"] = EVIL
    return result, log


class Reader(html.parser.HTMLParser):
    def __init__(self):
        super().__init__()
        self.tags, self.handlers, self.scripts = set(), set(), []

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        if tag == "script":
            self.scripts.append([dict(attrs), ""])
        self.handlers |= {name for name, _ in attrs if name.startswith("on")}

    def handle_data(self, data):
        if self.cdata_elem == "script":
            self.scripts[-1][1] += data


@pytest.mark.parametrize("with_log", [False, True])
@pytest.mark.slow
def test_no_string_of_a_file_becomes_markup(hostile, with_log):
    result, log = hostile
    text = page(load([result, log] if with_log else [result]))
    assert "alert(1)" in text  # as text: otherwise nothing was tried
    reader = Reader()
    reader.feed(text)
    assert reader.handlers == set()
    assert not reader.tags & {"img", "b", "u", "iframe", "object", "embed", "link"}
    ours = (resources.files("lpvobs") / "report/templates/course.js").read_text(encoding="utf-8").strip()
    run = [text.strip() for attributes, text in reader.scripts if attributes != {"type": "application/json"}]
    assert run == [ours] * with_log  # the page's own, which draws courses over time
    assert text.count("\ufffd[2J\ufffd\ufffd") > 0  # where they were: otherwise nothing was tried
    assert not [sign for sign in text if not sign.isprintable() and sign not in "\n\t\xa0\u2009\u202f"]


def test_nothing_in_the_package_unpickles_evaluates_or_runs_a_shell():
    root = ROOT / "lpvobs"
    bad = {"cPickle", "dill", "shelve", "marshal", "cloudpickle", "joblib"}
    for path in root.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = set()
            if isinstance(node, ast.Import):
                names = {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                names = {str(node.module).split(".")[0]}
                assert node.module != "pickle", path
            assert not names & bad, path
            if isinstance(node, ast.Call):
                called = ast.unparse(node.func)
                assert called not in ("eval", "exec", "os.system", "os.popen", "yaml.load"), path
                assert not called.startswith("pickle.") or called == "pickle.dumps", path  # to take a digest of
                keywords = {item.arg: ast.unparse(item.value) for item in node.keywords}
                assert keywords.get("shell", "False") == "False", path
                assert keywords.get("allow_pickle", "False") == "False", path


def test_a_period_that_no_step_counts_is_a_usage_error(tmp_path):
    """Found by the fuzzer: 1e308 over the step of the integrator is infinite."""
    odd = tmp_path / "odd.toml"
    text = DIESEL.read_text()
    odd.write_text(text.replace("period = 0.01 ", "period = 1e308 "))
    assert odd.read_text() != text
    with pytest.raises(UsageError, match="far too large"):
        load_config(odd)


WORK = """
from lpvobs.api.jobs import Workers
if __name__ == "__main__":
    with Workers(2) as workers:
        print(sorted(workers.finished(abs, [-3, -4])))
"""


def test_workers_take_no_module_from_the_folder_of_the_logs(tmp_path):
    script, folder = tmp_path / "work.py", tmp_path / "logs"
    script.write_text(WORK)
    folder.mkdir()
    (folder / "multiprocessing.py").write_text("open('run', 'w').close()\n")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONSAFEPATH"}
    environment["PYTHONPATH"] = str(ROOT)
    call = [sys.executable, str(script)]
    done = subprocess.run(call, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=120)
    assert (done.stdout, done.stderr) == ("[(0, 3), (1, 4)]\n", "")
    assert not (folder / "run").exists()


def test_objects_in_hdf5_that_h5py_would_unpickle_do_not_exist(samples):
    """h5py reads opaque and object types as bytes and strings; a result holds numbers and texts only."""
    kinds = set()
    with h5py.File(samples.result) as file:
        file.visititems(lambda name, item: kinds.add(item.dtype.kind) if isinstance(item, h5py.Dataset) else None)
    assert kinds <= {"f", "i", "u", "O"}  # O: variable-length UTF-8
