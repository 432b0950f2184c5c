"""Figures of the extremes: held to their limits, and printed as one table at the end."""

import numpy as np
import pytest


@pytest.fixture
def holds(record_property):
    """Asserts that a figure is finite and within its limit, and records both for the table."""

    def check(row: str, figure: float, limit: float) -> None:
        record_property("figure", (row, float(figure), float(limit)))
        assert np.isfinite(figure), row
        assert figure <= limit, row

    return check


def pytest_collection_modifyitems(items):
    for item in items:
        if item.path.parent.name == "extremes" and not item.get_closest_marker("quick"):
            item.add_marker(pytest.mark.slow)


def pytest_terminal_summary(terminalreporter):
    reports = [report for kind in ("passed", "failed") for report in terminalreporter.stats.get(kind, [])]
    figures = [value for report in reports for name, value in report.user_properties if name == "figure"]
    if not figures:
        return
    width = max(len(row) for row, *_ in figures)
    terminalreporter.section("extremes")
    for row, figure, limit in sorted(figures, key=lambda one: one[0].partition(": ")[::-1]):
        terminalreporter.line(f"{row:{width}}  {figure:9.2g}  ≤ {limit:g}")
