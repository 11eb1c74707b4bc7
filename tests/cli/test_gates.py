"""Gates and their JUnit file on the command line."""

from xml.etree import ElementTree

from repository import ROOT


def outcomes(path):
    root = ElementTree.parse(path).getroot()
    return {case.get("name").split(": ")[1]: next(item.tag for item in case) for case in root.iter("testcase")}


def test_every_gate_is_judged_and_the_file_is_there_when_one_fails(lpvobs, chain, tmp_path):
    xml = tmp_path / "gates.xml"
    gates = ("--gate", "mean_relative_error<=0", "--gate", "samples>=100", "--gate", "gaps<=0")
    said_again = ("--gate", "samples >= 1e2")
    done = lpvobs("report", chain.result, *gates, *said_again, "--junit", xml)
    assert done.code == 1
    assert done.err.strip().splitlines()[-1].startswith("lpvobs: gate failed: result: log ftp75_cold has mean_relative")
    assert ElementTree.parse(xml).getroot().get("tests") == "3"
    assert outcomes(xml) == {
        "mean_relative_error<=0": "failure",
        "samples>=100": "system-out",
        "gaps<=0": "system-out",
    }
    done = lpvobs("report", chain.result, *gates[2:], "--junit", xml, "--json")
    assert done.code == 0, done.err
    assert done.json["schema"] == "lpvobs/report/1"
    assert set(outcomes(xml).values()) == {"system-out"}


def test_a_real_log_has_gates(lpvobs, chain, tmp_path):
    """Nothing here needs the truth; the verdict waits for trace."""
    gates = ("--gate", "standard_error<=1e-3", "--gate", "nodes_estimated>=20", "--gate", "balance_agreement<=3")
    xml = tmp_path / "gates.xml"
    done = lpvobs("report", chain.result, *gates, "--junit", xml)
    assert done.code == 0, done.err
    names = [case.get("name") for case in ElementTree.parse(xml).getroot().iter("testcase")]
    assert names == ["standard_error<=0.001", "nodes_estimated>=20", "balance_agreement<=3"]
    assert lpvobs("report", chain.result, "--gate", "standard_error<=1e-9").code == 1
    done = lpvobs("report", chain.result, "--gate", "verdict==none")
    assert done.code == 3
    assert "needs a run of trace or refine" in done.err


def test_a_log_without_truth_has_fit_and_residual(lpvobs, bare):
    assert lpvobs("report", bare.result, "--gate", "fit>=0.5").code == 3  # without the log
    done = lpvobs("report", bare.result, bare.log, "--gate", "fit>=0.9", "--gate", "lags_outside<=0.2", "--json")
    assert done.code == 0, done.err
    balances = {item["balance"]: item for item in done.json["fits"]}
    assert set(balances) == {"compressor", "filling"}
    assert set(balances["filling"]["cross"]) >= {"u_delta", "u_egr", "u_vgt", "n_e"}
    assert all(len(r) == 51 for r in balances["filling"]["cross"].values())


def test_the_page_of_metrics_has_what_the_command_line_lists(lpvobs):
    page = (ROOT / "docs" / "metrics.md").read_text(encoding="utf-8")
    done = lpvobs("report", "--list-metrics")
    assert done.code == 0
    assert done.out in page


def test_refusals(lpvobs, chain, tmp_path):
    before = chain.result.read_bytes()
    target = tmp_path / "a.xml"
    for arguments in (
        ("--junit", target),
        ("--gate", "gaps<=0", "--junit", chain.result),
        ("--html", chain.result),
        ("--gate", "gaps<=0", "--junit", target, "--html", target),
    ):
        done = lpvobs("report", chain.result, *arguments)
        assert done.code == 2, done.err
        assert len(done.err.strip().splitlines()) == 1
        assert "--out" not in done.err, "report has no such option"
    assert chain.result.read_bytes() == before
    assert list(tmp_path.iterdir()) == []
