"""Two maps beside each other: nothing where nothing has changed, the place and size of what has, gates in any unit."""

from xml.etree import ElementTree

import h5py
import numpy as np
import pytest

import lpvobs
from lpvobs.errors import DataError, NotProven, UsageError
from lpvobs.report.figures import READING

SPEED, FUEL = np.arange(500.0, 3001.0, 500.0), np.arange(0.0, 41.0, 10.0)
SHAPE = (SPEED.size, FUEL.size)
NOISE = 1e-8 * (0.1 * np.eye(30) + 0.9)
"""[kg^2/s^2], 0.1 g/s a node, of which nine tenths are common."""


def write(path, values):
    with h5py.File(path, "w") as file:
        file.attrs["schema"] = "lpvobs/result/1"
        group = file.create_group("map")
        for axis, nodes, unit in (("n_e", SPEED, "rpm"), ("u_delta", FUEL, "mg/cycle")):
            group[axis] = nodes
            group[axis].attrs.update({"units": unit, "long_name": axis})
        group["delta_W_c"], group["standard_error"] = values, np.where(np.isnan(values), np.nan, 1e-4)
        group["support"] = np.isfinite(values).astype(np.int8)
        group["delta_W_c"].attrs["units"] = "kg/s"
        group.attrs["axes"] = "u_delta n_e"
        file["nodes/covariance"] = NOISE
    return path


def two(tmp_path, change, seed=1):
    """Return two results whose maps differ by noise and by a change."""
    root, rng = np.linalg.cholesky(NOISE), np.random.default_rng(seed)
    draws = [(root @ rng.standard_normal(30)).reshape(SHAPE) for _ in range(2)]
    return write(tmp_path / "a.h5", draws[0]), write(tmp_path / "b.h5", draws[1] + change)


@pytest.mark.proof
def test_where_nothing_has_changed_nothing_is_found(tmp_path):
    p_values, held, accused = [], [], 0
    for seed in range(100):
        found = lpvobs.compare(*two(tmp_path, 0.0, seed))
        p_values.append(found.p_value)
        held.append(found.mean.ci90[0] <= 0.0 <= found.mean.ci90[1])
        accused += bool(found.significant)
    # Of a hundred, within two and a half standard deviations of what is promised.
    assert abs(np.mean(held) - 0.9) < 0.075
    assert abs(np.mean(np.array(p_values) < 0.1) - 0.1) < 0.075
    assert accused <= 10


def test_a_node_that_has_changed_is_found_with_its_size(tmp_path):
    change = np.zeros(SHAPE)
    change[2, 3] = 1e-3
    found = lpvobs.compare(*two(tmp_path, change))
    assert [(node.speed, node.fuel) for node in found.significant] == [(1500.0, 30.0)]
    node = found.significant[0]
    assert node.ci90[0] <= 1e-3 <= node.ci90[1]
    assert node.after - node.before == pytest.approx(node.change)
    assert found.p_value < 1e-6
    assert found.largest_change == abs(node.change)


@pytest.mark.slow
def test_the_figure_frames_what_has_changed_and_shows_every_node(tmp_path):
    change = np.zeros(SHAPE)
    change[2, 3] = 1e-3
    pair = two(tmp_path, change)
    framed = []
    for figure, maps in (("changed.svg", pair), ("alike.svg", (pair[1], pair[1]))):
        lpvobs.compare(*maps, figure=tmp_path / figure)
        root = ElementTree.parse(tmp_path / figure).getroot()
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        assert sum(":" in (title.text or "") for title in root.iter("{http://www.w3.org/2000/svg}title")) == 30
        framed.append((tmp_path / figure).read_text().count(READING))
    assert framed == [1, 0]
    with pytest.raises(UsageError, match="is also an input"):
        lpvobs.compare(*pair, figure=pair[0])


def test_a_region_and_gates(tmp_path):
    pair = two(tmp_path, 1e-3)
    region = {"n_e": (1000.0, 2000.0), "u_delta": (10.0, 30.0)}
    found = lpvobs.compare(*pair, region=region, gates=["largest_change<=2 g/s", "mean_change < 2 kg/s", "p_value>=0"])
    low, high = found.mean.ci90
    assert low <= 1e-3 <= high
    # Nine tenths of the errors are common to all nodes: the mean is hardly surer than a node.
    assert high - low == pytest.approx(2 * 1.645 * np.sqrt(2 * 0.9) * 1e-4, rel=0.03)
    with pytest.raises(NotProven, match=r"largest_change = 0.001.*the gate is largest_change<=0.0005 kg/s"):
        lpvobs.compare(*pair, gates=["largest_change<=0.5 g/s"])
    with pytest.raises(UsageError, match="'bar' is not a unit of flow"):
        lpvobs.compare(*pair, gates=["largest_change<=0.5 bar"])
    with pytest.raises(UsageError, match="did you mean 'largest_change'"):
        lpvobs.compare(*pair, gates=["largest<=0.5"])
    with pytest.raises(UsageError, match="--values trace"):
        lpvobs.compare(*pair, values="trace")


def test_maps_with_nothing_in_common_are_refused(tmp_path):
    values = np.zeros(SHAPE)
    values[3:] = np.nan
    one, other = write(tmp_path / "a.h5", values), write(tmp_path / "b.h5", np.flipud(values))
    with pytest.raises(DataError, match="no node has a value with a standard error in both"):
        lpvobs.compare(one, other)
