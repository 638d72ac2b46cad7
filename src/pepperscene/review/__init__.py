"""Check, report and preview of a data set."""
