"""Training of networks: samples, loss, optimiser, checkpoints."""

from pepperscene.learning.options import TrainingProgress
from pepperscene.learning.training.run import train

__all__ = ["TrainingProgress", "train"]
