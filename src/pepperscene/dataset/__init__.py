"""Data sets: a recipe says what is wanted, a plan numbers frames, a build makes them, a report shows them."""

from pepperscene.dataset.check import CheckResult, Finding, check_dataset
from pepperscene.dataset.execution.build import BuildProgress, BuildResult, build
from pepperscene.dataset.export import FORMATS, ExportResult, Splits, export_dataset
from pepperscene.dataset.readers import open_images
from pepperscene.dataset.readers.image_set import VOID, ImageSet, LabelledImage
from pepperscene.dataset.readers.torch_images import torch_images
from pepperscene.dataset.recipe.load import load_recipe, parse_changes
from pepperscene.dataset.recipe.plan import FrameSpec, Plan
from pepperscene.dataset.recipe.recipe import Recipe
from pepperscene.dataset.report import ReportFiles, write_report
from pepperscene.dataset.scenes.frame_renderer import FrameRenderer
from pepperscene.dataset.scenes.plants import GrownPlant, grow_plant
from pepperscene.dataset.scenes.single_frame import render_frame
from pepperscene.dataset.store.dataset import Dataset, open_dataset
from pepperscene.dataset.store.images import read_image, write_image

__all__ = [
    "FORMATS",
    "VOID",
    "BuildProgress",
    "BuildResult",
    "CheckResult",
    "Dataset",
    "ExportResult",
    "Finding",
    "FrameRenderer",
    "FrameSpec",
    "GrownPlant",
    "ImageSet",
    "LabelledImage",
    "Plan",
    "Recipe",
    "ReportFiles",
    "Splits",
    "build",
    "check_dataset",
    "export_dataset",
    "grow_plant",
    "load_recipe",
    "open_dataset",
    "open_images",
    "parse_changes",
    "read_image",
    "render_frame",
    "torch_images",
    "write_image",
    "write_report",
]
