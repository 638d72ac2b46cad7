"""The report: a contact sheet and one web page that shows a data set, and a second one beside it."""

from pepperscene.dataset.report.write import ReportFiles, write_report

__all__ = ["ReportFiles", "write_report"]
