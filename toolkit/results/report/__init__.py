"""A run as one self-contained HTML page."""

from toolkit.results.report.completion_page import write_completion_report
from toolkit.results.report.motion_page import write_report

__all__ = ["write_completion_report", "write_report"]
