"""The gate of a data set: what is damaged, missing, impossible or unlike what the recipe expects of it."""

from pepperscene.dataset.check.gate import check
from pepperscene.dataset.check.verdict import KINDS, Finding, Verdict

__all__ = ["KINDS", "Finding", "Verdict", "check"]
