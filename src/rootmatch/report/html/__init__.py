"""A match as one page for the browser, which needs no network: ``rootmatch match --report``, `Match.report`."""

from rootmatch.report.html.page import check_report, write_report

__all__ = ["check_report", "write_report"]
