"""Networks that separate organ classes: a small one, the paper's, and those of the user."""

from pepperscene.learning.models.detections import Detections
from pepperscene.learning.models.onnx_export import export_model
from pepperscene.learning.models.registry import build_model
from pepperscene.learning.models.trained_model import TrainedModel, load_model

__all__ = ["Detections", "TrainedModel", "build_model", "export_model", "load_model"]
