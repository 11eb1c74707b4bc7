"""The report from the command line: table, JSON, gates, and one page that needs nothing else."""

import os
import re
import subprocess

import numpy as np
import pytest
from repository import DIESEL
from verbs import AFRESH

from lpvobs.report.content import load


def test_json_has_the_papers_figure_beside_its_own(lpvobs, chain):
    (log,) = lpvobs("report", chain.result, "--json").json["logs"]
    assert log["paper_mean_relative_error"] == 0.0528


@pytest.mark.parametrize(
    ("gate", "code"),
    [
        ("rmse>1", 1),
        ("samples>=100", 0),
        ("mean_relativ_error<=1", 2),
        ("mean_relative_error", 2),
        ("mean_relative_error<=often", 2),
    ],
)
def test_gates(lpvobs, chain, gate, code):
    assert lpvobs("report", chain.result, "--gate", gate).code == code


def test_a_gate_on_what_a_log_cannot_have(lpvobs, bare, tmp_path):
    assert lpvobs("report", bare.result, "--gate", "mean_relative_error<=1").code == 3
    page = tmp_path / "bare.html"
    done = lpvobs("report", bare.result, bare.log, "--html", page)
    assert done.code == 0
    assert "rmse" not in done.out  # no column where no log has a value
    text = page.read_text()
    assert "no reference channels" in text
    assert "How well does the model predict the reading?" in text
    assert re.search(
        r"the sensor reads [\d.]+ % low, -[\d.]+ g/s on average \(90 %: .*; the air flow balances agree", text
    )
    order = [
        "verdict",
        "map",
        "quality",
        "driving",
        "residual",
        "courses",
        "model",
        "coefficients",
        "logs",
        "provenance",
    ]
    assert re.findall(r'<section id="(\w+)"', text) == order
    # Provenance has commands with the paths of files.
    told = text.partition('<section id="provenance"')[0].partition("<body>")[2]
    for of_the_paper in ("Figure", "paper", "rmse"):
        assert of_the_paper not in told
    read = re.sub(r"<(script|style|svg).*?</\1>|<[^>]*>", " ", told, flags=re.DOTALL)
    assert not re.search(r"[-−]0(\.0+)?(?![\d.])", read)


def test_the_course_of_a_slow_sensor_is_the_one_that_the_map_was_made_from(lpvobs, chain, tmp_path):
    config, slow = tmp_path / "slow.toml", tmp_path / "slow.h5"
    text = DIESEL.read_text(encoding="utf-8")
    config.write_text(text.replace("\n[policies]", "\n[sensors.W_maf]\ntau = 0.5\n[policies]"), encoding="utf-8")
    done = lpvobs("estimate", "--config", config, "--gain", chain.gain, chain.log, "--out", slow)
    assert done.code == 0, done.err
    ((right,), (recorded,)) = (load([result, chain.log]).drives.values() for result in (slow, chain.result))
    second = np.ones(20) / 20.0
    change, rate = (
        np.convolve(x, second, "valid") for x in (right.measured - recorded.measured, np.gradient(recorded.measured))
    )
    assert change @ rate / (rate @ rate) == pytest.approx(0.5 * 20.0, rel=0.1)  # tau over the step of the samples


def test_one_page_that_needs_nothing_else(lpvobs, chain, page, tmp_path):
    again = tmp_path / "again.html"
    done = lpvobs("report", chain.result, chain.log, "--html", again)
    assert done.code == 0, done.err
    text = page.read_text()
    assert text == again.read_text()
    assert len(text) < 2_000_000
    assert not re.search(
        r"""(src|href)\s*=\s*["']?(https?:)?//|url\(\s*["']?(https?:)?//|<script[^>]*src|fetch\(|import\(""", text
    )
    for heading in (
        "Verdict",
        "FTP75 cold transient",
        "Table 1",
        "Figures 6a, 9a",
        "Extrapolation",
        "Provenance",
        "Observer gain L",
    ):
        assert heading in text
    figures = re.findall(r"<figure[^>]*><svg [^>]*aria-label=\"([^\"]+)\"", text)
    assert len(figures) == text.count("<figure") >= 8
    assert all(f'id="{target}"' in text for target in re.findall(r'href="#([^"]+)"', text))


@pytest.mark.proof
def test_what_stands_in_a_file_is_never_markup(lpvobs, config, chain, tmp_path):
    odd = tmp_path / "<b onclick=alert(1)>.parquet"
    odd.write_bytes(chain.log.read_bytes())
    out, page = tmp_path / "r.h5", tmp_path / "r.html"
    assert lpvobs("estimate", "--config", config, "--gain", chain.gain, odd, "--out", out).code == 0
    assert lpvobs("report", out, odd, "--html", page).code == 0
    assert "<b onclick" not in page.read_text()
    assert "&lt;b onclick" in page.read_text()


def test_a_log_that_made_none_of_the_results(lpvobs, chain, tmp_path):
    other = tmp_path / "other.parquet"
    other.write_bytes(chain.log.read_bytes() + b"x")
    done = lpvobs("report", chain.result, other)
    assert done.code == 3
    assert len(done.err.strip().splitlines()) == 1
    assert str(other) in done.err


@pytest.fixture
def page_with(chain, tmp_path):
    """Return a function that makes the page with a variable set; libraries are loaded afresh, and read it then."""

    def made(name, value):
        call = [*AFRESH, "report", str(chain.result), "--html", str(tmp_path / "report.html")]
        environment = {**os.environ, name: value}
        return subprocess.run(call, env=environment, capture_output=True, text=True, timeout=100, check=False)

    return made


@pytest.mark.slow
def test_an_environment_that_a_library_cannot_read_is_one_line(page_with, tmp_path):
    done = page_with("SOURCE_DATE_EPOCH", "abc")
    assert done.returncode == 2, done.stderr
    (line,) = done.stderr.strip().splitlines()
    assert "SOURCE_DATE_EPOCH" in line
    assert "abc" in line
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_backend_that_matplotlib_does_not_know_is_not_needed_for_a_page(page_with, tmp_path):
    done = page_with("MPLBACKEND", "nonsense")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "report.html").exists()


def test_a_mean_over_a_region_stands_on_the_page_as_it_is_printed(chain, lpvobs, tmp_path):
    page, region = tmp_path / "region.html", "n_e=1500:2000,u_delta=8:16"
    done = lpvobs("report", chain.result, "--html", page, "--region", region)
    said = next(line for line in done.out.splitlines() if "mean error over n_e 1500 to 2000" in line)
    assert said in page.read_text(encoding="utf-8")
