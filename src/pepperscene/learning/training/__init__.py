"""Training of networks: samples, loss, optimiser, checkpoints."""

from pepperscene.learning.training.options import TrainingOptions
from pepperscene.learning.training.train import TrainingProgress, train

__all__ = ["TrainingOptions", "TrainingProgress", "train"]
