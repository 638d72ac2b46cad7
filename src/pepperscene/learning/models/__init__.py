"""Networks that separate organ classes: a small one, the paper's, and those of the user."""

from pepperscene.learning.models.registry import build_model
from pepperscene.learning.models.trained_model import TrainedModel, load_model

__all__ = ["TrainedModel", "build_model", "load_model"]
