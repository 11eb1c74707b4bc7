"""Gates and their JUnit file on the command line."""

from xml.etree import ElementTree


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
