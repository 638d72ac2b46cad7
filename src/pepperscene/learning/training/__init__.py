"""Training of networks: samples, loss, optimiser, checkpoints."""

from pepperscene.learning.training.loop import TrainingProgress, train
from pepperscene.learning.training.options import TrainingOptions

__all__ = ["TrainingOptions", "TrainingProgress", "train"]
