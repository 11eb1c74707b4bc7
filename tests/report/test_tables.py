"""Rows of text: the coefficients of a map stand under the axes of its own engine."""

from types import SimpleNamespace

import numpy as np

from lpvobs.maps.quadratic import Filled
from lpvobs.report.tables import coefficient_tables, grams, percent

NODES = np.zeros((2, 2))
FITTED = Filled(
    "quadratic", np.arange(6.0), np.ones(6), 1e-4, NODES[0], 7, NODES, np.eye(4), NODES, NODES.astype(np.int8)
)


def result(air_path, fitted=FITTED):
    return SimpleNamespace(air_path=air_path, extrapolation=fitted)


def test_each_engine_has_a_table_with_its_axes_and_what_is_printed_for_it():
    results = [
        ("a", result("diesel")),
        ("b", result("throttled")),
        ("c", result("diesel")),
        ("d", result("diesel", None)),
    ]
    (head, rows), (other_head, other_rows) = coefficient_tables(results, paper=True)
    assert head == ["kg/s over u_delta [mg/cycle], n_e [rpm]", "a2", "a1", "b2", "b1", "c2", "c1"]
    assert [row[0] for row in rows[:4]] == ["a", "  standard error", "c", "  standard error"]
    assert [row[0] for row in rows[4:]] == ["paper, ETC part 1, Eq. (39)", "paper, FTP75 cold transient, Eq. (40)"]
    assert rows[0][1:] == ["0", "1", "2", "3", "4", "5"]
    assert other_head[0] == "kg/s over m_f [1], n_e [rpm]"
    assert [row[0] for row in other_rows] == ["b", "  standard error"]


def test_the_papers_rows_stand_in_the_papers_comparison_alone():
    ((_, rows),) = coefficient_tables([("a", result("diesel"))])
    assert [row[0] for row in rows] == ["a", "  standard error"]


def test_zero_has_no_sign():
    assert (percent(-1e-6, 1), grams(-1e-9)) == ("0.0 %", "0.000")


def test_nothing_extrapolated_is_no_table():
    assert coefficient_tables([("d", result("diesel", None))]) == []
