"""A run as one self-contained HTML page."""

from toolkit.report.completion_page import write_completion_report
from toolkit.report.page import write_report

__all__ = ["write_completion_report", "write_report"]
