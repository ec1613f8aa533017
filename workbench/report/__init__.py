"""Report of a set of turns as one HTML page that opens without a network; its text and figures come from the runs."""

from aerodima.workbench.report.turn_report import ReportFiles, turn_report

__all__ = ["ReportFiles", "turn_report"]
