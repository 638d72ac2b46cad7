"""Training networks on labelled images, and evaluating them (extra `learn`)."""

from pepperscene.learning.class_table import FRUIT_CLASSES, ClassTable
from pepperscene.learning.evaluation.evaluate import evaluate
from pepperscene.learning.evaluation.evaluation import Evaluation
from pepperscene.learning.evaluation.page import EvaluationFiles, write_evaluation
from pepperscene.learning.evaluation.predict import Predictions, predict
from pepperscene.learning.evaluation.segmenter import Segmenter
from pepperscene.learning.training_options import TrainingOptions

__all__ = [
    "FRUIT_CLASSES",
    "ClassTable",
    "Evaluation",
    "EvaluationFiles",
    "Predictions",
    "Segmenter",
    "TrainingOptions",
    "evaluate",
    "predict",
    "write_evaluation",
]
