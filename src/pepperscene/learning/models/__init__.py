"""Networks that separate organ classes: a small one, the paper's, and those of the user."""

from pepperscene.learning.models.registry import MODELS, ModelDefaults, build_model, model_defaults
from pepperscene.learning.models.trained_model import TrainedModel, load_model

__all__ = ["MODELS", "ModelDefaults", "TrainedModel", "build_model", "load_model", "model_defaults"]
