"""Checks of a data set for damaged, missing and impossible content, and for statistics out of range."""

from pepperscene.review.check.findings import KINDS, CheckResult, Finding
from pepperscene.review.check.run import check_dataset

__all__ = ["KINDS", "CheckResult", "Finding", "check_dataset"]
