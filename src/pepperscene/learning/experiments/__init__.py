"""The experiments A to E of Barth et al. 2018: what synthetic images teach about real ones."""

from pepperscene.learning.experiments.page import write_page
from pepperscene.learning.experiments.results import Results
from pepperscene.learning.experiments.run import run_experiments

__all__ = ["Results", "run_experiments", "write_page"]
