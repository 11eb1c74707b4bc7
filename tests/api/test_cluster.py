"""Many machines: a real scheduler with two workers, one of which dies half-way, and the map, or the fleet, of one process."""

import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hdf5 import contents
from repository import DIESEL

import lpvobs
from lpvobs.api import groups, jobs
from lpvobs.api.fleet import estimate_fleet
from lpvobs.api.known_engine import learned_engine
from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.errors import DataError, UsageError
from lpvobs.io.configuration.config import load_config
from lpvobs.io.logs.parquet import write_log
from lpvobs.observer.parts import StateGain
from lpvobs.simulation.simulate import simulate

LOGS = 6


@pytest.fixture(scope="module")
def setting():
    config, text = load_config(DIESEL)
    L = np.array([[2215.0, -4.2, 156.0, 0.0], [-113.0, 2129.0, -88.0, 0.0], [55.0, -1.1, 2015.0, 0.0]])
    return config, text, StateGain(("p_im", "p_em", "omega_t"), L)


@pytest.fixture(scope="module")
def logs(setting, tmp_path_factory):
    """Return overlapping pieces of a drive, long enough that a worker can be killed in the middle of one."""
    config = setting[0]
    drive = simulate(config.engine, config.simulation, "ftp75_cold", 100.0, 1)
    folder = tmp_path_factory.mktemp("logs")
    N = drive.channels["time"].size
    step = N // 9
    for number in range(LOGS):
        part = slice(number * step, (number + 2) * step)
        channels = {name: drive.channels[name][part] for name in ("time", *Diesel.channels)}
        origin = {"vehicle": "ab"[number % 2], "date": f"2025-0{1 + number // 2}-15"}
        write_log(folder / f"{number}.parquet", channels, drive.units, origin)
    return sorted(folder.iterdir())


def estimated(setting, logs, out, workers, progress=lambda _: None):
    config, text, gain = setting
    return estimate_fleet(learned_engine(config, ()), text, gain, logs, out, workers, progress)


@pytest.fixture(scope="module")
def alone(setting, logs, tmp_path_factory):
    return estimated(setting, logs, tmp_path_factory.mktemp("alone") / "r.h5", jobs.Workers())


@pytest.fixture(scope="module")
def followed(chain):
    """Return a function that follows the vehicles of logs, and returns what stands in the fleet."""

    def run(logs, out, progress=None, **workplace):
        _, found = lpvobs.track(DIESEL, logs, out=out, gain=chain.gain, progress=progress, **workplace)
        assert (found.new, found.refused, list(out.parent.glob("*.parts"))) == (len(logs), (), [])
        return contents(out)

    return run


@pytest.fixture(scope="module")
def fleet(followed, logs, tmp_path_factory):
    return followed(logs, tmp_path_factory.mktemp("fleet") / "f.h5", jobs=1)


def once_done(parts, count, then):
    """Return a function for progress that does something once, when so many logs have left their part."""
    waiting = [then]

    def progress(_):
        if waiting and len(list(parts.glob("[!.]*.part"))) >= count:
            waiting.pop()()

    return progress, waiting


def same(a, b):
    for name in ("theta", "covariance", "sensitivity", "design", "excitation"):
        np.testing.assert_array_equal(getattr(a.estimate, name), getattr(b.estimate, name))
    assert a.agreement == b.agreement


def squared(number):
    """Return the square; a task that any process can import."""
    if number == 13:
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


@pytest.mark.parametrize("processes", [1, 2])
def test_every_task_comes_back_once_with_its_number(processes):
    tasks = list(range(12))
    with jobs.Workers(processes) as workers:
        assert sorted(workers.finished(squared, tasks)) == [(n, n * n) for n in tasks]
        assert list(workers.finished(squared, [])) == []


@pytest.mark.slow
def test_a_worker_that_dies_is_said_in_one_line():
    with pytest.raises(DataError, match="worker process died") as failure, jobs.Workers(2) as workers:
        list(workers.finished(squared, [13, 1, 2]))
    assert "\n" not in str(failure.value)


@pytest.mark.proof
def test_processes_give_the_map_of_one_process(setting, logs, alone, tmp_path):
    same(estimated(setting, logs, tmp_path / "r.h5", jobs.Workers(2)), alone)


@pytest.mark.proof
def test_several_groups_of_logs_give_one_map_in_any_number_of_processes(setting, logs, alone, tmp_path, monkeypatch):
    monkeypatch.setattr(groups, "TOGETHER", 2)
    found = [estimated(setting, logs, tmp_path / f"{n}.h5", jobs.Workers(n)) for n in (1, 2)]
    same(*found)
    # Another order of the same sums: their rounding is far below what noise leaves of a node.
    a, b = found[0].estimate, alone.estimate
    np.testing.assert_array_equal(a.supported, b.supported)
    assert np.max((np.abs(a.theta - b.theta) / b.standard_error)[b.supported]) < 1e-6
    assert [run.name for run in found[0].estimate.runs] == [run.name for run in alone.estimate.runs]


def test_what_finishes_early_waits_for_its_turn(monkeypatch):
    monkeypatch.setattr(groups, "TOGETHER", 2)
    backwards = lambda _, function, tasks: list(enumerate(map(function, tasks)))[::-1]  # noqa: E731
    monkeypatch.setattr(jobs.Workers, "finished", backwards)
    found = {letter: letter.upper() for letter in "cadbe"}
    assert list(groups.by_group(jobs.Workers(), found, list)) == [["a", "b"], ["c", "d"], ["e"]]


@pytest.mark.proof
def test_processes_give_the_fleet_of_one_process(followed, logs, fleet, tmp_path):
    assert followed(logs[::-1], tmp_path / "f.h5", jobs=2) == fleet


@pytest.mark.slow
def test_who_finishes_last_changes_no_bit_of_a_fleet(followed, logs, tmp_path, monkeypatch):
    """Nor does the order in which the logs are named."""
    (tmp_path / "in order").mkdir()
    in_order = followed(logs[:3], tmp_path / "in order" / "f.h5", jobs=1)
    backwards = lambda _, function, tasks: list(enumerate(map(function, tasks)))[::-1]  # noqa: E731
    monkeypatch.setattr(jobs.Workers, "finished", backwards)
    assert followed([logs[2], logs[0], logs[1]], tmp_path / "f.h5", jobs=1) == in_order


@pytest.mark.proof
def test_a_scheduler_that_is_not_there_is_said_in_one_line():
    pytest.importorskip("distributed", reason="Dask is not installed; pip install lpvobs[cluster]")
    with pytest.raises(UsageError, match="cannot be reached") as failure:
        list(jobs.Workers(scheduler="tcp://127.0.0.1:1").finished(squared, [1]))
    assert "\n" not in str(failure.value)


class Client:
    """Dask's client in small, with threads for workers; asked once too often, its scheduler has been gone for too long."""

    def __init__(self, questions):
        self.status, self.questions = "running", questions

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def get_executor(self, **_):
        return ThreadPoolExecutor(1)

    def nthreads(self):
        self.questions -= 1
        if self.questions < 0:
            self.status = "closed"
            raise AttributeError("'NoneType' object has no attribute 'ncores'")  # what Dask says
        return {"worker": 1}


def test_a_scheduler_that_was_gone_for_too_long_gets_what_is_left(monkeypatch):
    pytest.importorskip("distributed", reason="Dask is not installed; pip install lpvobs[cluster]")
    made = iter([Client(3), Client(0), Client(100)])
    monkeypatch.setattr(jobs, "_client", lambda *_: next(made))
    tasks = list(range(12))
    assert sorted(jobs.Workers(scheduler="tcp://gone").finished(squared, tasks)) == [(n, n * n) for n in tasks]
    assert next(made, None) is None


def start(folder, name, *arguments):
    """Start a part of Dask that keeps everything in a folder of its own."""
    environment = os.environ | {
        "DASK_TEMPORARY_DIRECTORY": str(folder),
        "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "10s",
        "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)]),
    }
    call = [sys.executable, "-m", f"distributed.cli.dask_{name.split('-')[0]}", *map(str, arguments)]
    with (folder / f"{name}.log").open("w") as said:
        return subprocess.Popen(call, stdout=said, stderr=said, env=environment, cwd=folder)


@pytest.fixture
def cluster(tmp_path):
    """Start a scheduler with two workers; yield its address and the workers' processes."""
    pytest.importorskip("distributed", reason="Dask is not installed; pip install lpvobs[cluster]")
    said = tmp_path / "scheduler.json"
    processes = [
        start(tmp_path, "scheduler", "--host", "127.0.0.1", "--port", 0, "--no-dashboard", "--scheduler-file", said)
    ]
    try:
        for number in range(2):
            arguments = ("--nthreads", 1, "--no-nanny", "--no-dashboard", "--scheduler-file", said)
            processes.append(start(tmp_path, f"worker-{number}", *arguments))
        yield address_in(said, processes[0]), processes[1:]
    finally:
        for process in processes[::-1]:
            process.kill()
            process.wait(timeout=30)


def address_in(said, scheduler):
    for _ in range(600):
        if said.exists() and said.stat().st_size:
            return json.loads(said.read_text())["address"]
        assert scheduler.poll() is None, (said.parent / "scheduler.log").read_text()
        time.sleep(0.05)
    raise AssertionError("the scheduler did not start within 30 s")


@pytest.mark.slow
def test_a_worker_that_is_killed_half_way_changes_no_bit(setting, logs, alone, cluster, tmp_path):
    from distributed import Client

    address, workers = cluster
    with Client(address, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
    seen = []

    def progress(fraction):
        seen.append(fraction)
        if len(seen) == 2:  # two of six logs are done, the others wait or are being worked on
            workers[0].kill()

    found = estimated(setting, logs, tmp_path / "r.h5", jobs.Workers(scheduler=address), progress)
    assert workers[0].wait(timeout=30) == -signal.SIGKILL
    assert workers[1].poll() is None
    assert len(seen) >= LOGS
    assert found.refused == ()
    same(found, alone)


@pytest.mark.proof
def test_a_worker_that_is_killed_half_way_changes_no_bit_of_a_fleet(followed, logs, fleet, cluster, tmp_path):
    from distributed import Client

    address, workers = cluster
    with Client(address, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
    progress, waiting = once_done(tmp_path / "f.h5.parts", 2, workers[0].kill)
    assert followed(logs, tmp_path / "f.h5", progress, scheduler=address) == fleet
    assert not waiting
    assert workers[0].wait(timeout=30) == -signal.SIGKILL
    assert workers[1].poll() is None


@pytest.fixture
def restarted(tmp_path):
    """Yield the address of a scheduler with a worker, and a function that kills both and starts others there."""
    pytest.importorskip("distributed", reason="Dask is not installed; pip install lpvobs[cluster]")
    running = []

    def begun(turn, port):
        folder = tmp_path / f"turn{turn}"
        folder.mkdir()
        said = folder / "scheduler.json"
        own = ("--no-dashboard", "--scheduler-file", said)
        running.append(start(folder, "scheduler", "--host", "127.0.0.1", "--port", port, *own))
        running.append(start(folder, "worker-0", "--nthreads", 1, "--no-nanny", *own))
        return address_in(said, running[-2])

    def ended():
        while running:
            process = running.pop()
            process.kill()
            process.wait(timeout=30)

    def again():
        ended()
        begun(1, address.rpartition(":")[2])

    address = begun(0, 0)
    try:
        yield address, again
    finally:
        ended()


@pytest.mark.proof
def test_a_scheduler_that_goes_away_and_comes_back_gets_what_is_left(setting, logs, alone, restarted, tmp_path):
    address, again = restarted
    seen = []

    def progress(fraction):
        seen.append(fraction)
        if len(seen) == 2:
            again()

    same(estimated(setting, logs, tmp_path / "r.h5", jobs.Workers(scheduler=address), progress), alone)
    assert len(seen) >= LOGS


@pytest.mark.proof
def test_a_scheduler_that_goes_away_and_comes_back_gets_what_is_left_of_a_fleet(
    followed, logs, fleet, restarted, tmp_path
):
    address, again = restarted
    progress, waiting = once_done(tmp_path / "f.h5.parts", 2, again)
    assert followed(logs, tmp_path / "f.h5", progress, scheduler=address) == fleet
    assert not waiting
