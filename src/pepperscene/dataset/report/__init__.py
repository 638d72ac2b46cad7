"""The report: a contact sheet and one web page that shows a data set, and a second one beside it."""

from pepperscene.dataset.report.write import Report, report

__all__ = ["Report", "report"]
