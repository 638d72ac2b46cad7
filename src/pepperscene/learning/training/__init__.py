"""Training of networks: samples, loss, optimiser, checkpoints."""

from pepperscene.learning.training.loop import TrainingProgress, train

__all__ = ["TrainingProgress", "train"]
