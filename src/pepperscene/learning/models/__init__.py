"""Networks that separate organ classes: a small one, the paper's, and those of the user."""

from pepperscene.learning.models.registry import MODELS, ModelDefaults, build_model, model_defaults
from pepperscene.learning.models.segmenter import Segmenter, load_model

__all__ = ["MODELS", "ModelDefaults", "Segmenter", "build_model", "load_model", "model_defaults"]
