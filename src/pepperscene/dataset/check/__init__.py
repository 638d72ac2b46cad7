"""The gate of a data set: what is damaged, missing, impossible or unlike what the recipe expects of it."""

from pepperscene.dataset.check.findings import KINDS, Finding, Verdict
from pepperscene.dataset.check.run import check

__all__ = ["KINDS", "Finding", "Verdict", "check"]
