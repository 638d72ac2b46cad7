"""Data sets: a recipe says what is wanted, a plan numbers frames, a build makes them, a report shows them."""

from pepperscene.dataset.check import Finding, Verdict, check
from pepperscene.dataset.execution.build import BuildResult, Progress, build
from pepperscene.dataset.export import FORMATS, Exported, Splits, export
from pepperscene.dataset.readers import open_images
from pepperscene.dataset.readers.image_set import VOID, ImageSet, Labelled
from pepperscene.dataset.readers.torch_images import torch_images
from pepperscene.dataset.recipe.load import load_recipe, read_changes
from pepperscene.dataset.recipe.plan import Plan, Shot
from pepperscene.dataset.recipe.recipe import Recipe
from pepperscene.dataset.report import Report, report
from pepperscene.dataset.scenes.frame_renderer import Stage
from pepperscene.dataset.scenes.plants import GrownPlant, grown
from pepperscene.dataset.scenes.single_frame import render_frame
from pepperscene.dataset.store.dataset import Dataset, open_dataset
from pepperscene.dataset.store.images import read_image, write_image

__all__ = [
    "FORMATS",
    "VOID",
    "BuildResult",
    "Dataset",
    "Exported",
    "Finding",
    "GrownPlant",
    "ImageSet",
    "Labelled",
    "Plan",
    "Progress",
    "Recipe",
    "Report",
    "Shot",
    "Splits",
    "Stage",
    "Verdict",
    "build",
    "check",
    "export",
    "grown",
    "load_recipe",
    "open_dataset",
    "open_images",
    "read_changes",
    "read_image",
    "render_frame",
    "report",
    "torch_images",
    "write_image",
]
