"""The gate of a data set: what is damaged, missing, impossible or unlike what the recipe expects of it."""

from pepperscene.dataset.check.findings import KINDS, CheckResult, Finding
from pepperscene.dataset.check.run import check_dataset

__all__ = ["KINDS", "CheckResult", "Finding", "check_dataset"]
