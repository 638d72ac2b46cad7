"""Report of a data set: a web page and a contact sheet, optionally compared with a second set."""

from pepperscene.review.report.write import ReportFiles, write_report

__all__ = ["ReportFiles", "write_report"]
