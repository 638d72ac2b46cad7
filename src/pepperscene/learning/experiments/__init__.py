"""The experiments of the paper (section 2.8): does synthetic training help on photographs?"""

from pepperscene.learning.experiments.run import ExperimentFiles, run_experiments
from pepperscene.learning.options import ExperimentOptions

__all__ = ["ExperimentFiles", "ExperimentOptions", "run_experiments"]
