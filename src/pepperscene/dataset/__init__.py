"""Data sets: a recipe says what is wanted, a plan numbers frames, a build makes them, a report shows them."""

from pepperscene.dataset.build import BuildResult, Progress, build
from pepperscene.dataset.changes import read_changes
from pepperscene.dataset.check import Finding, Verdict, check
from pepperscene.dataset.export import FORMATS, Exported, Splits, export
from pepperscene.dataset.grown import GrownPlant, grown
from pepperscene.dataset.images import read_image, write_image
from pepperscene.dataset.labelled import VOID, ImageSet, Labelled
from pepperscene.dataset.plan import Plan, Shot
from pepperscene.dataset.readers import open_images
from pepperscene.dataset.recipe import Recipe
from pepperscene.dataset.recipe_file import load_recipe
from pepperscene.dataset.report import Report, report
from pepperscene.dataset.single import render_frame
from pepperscene.dataset.stage import Stage
from pepperscene.dataset.store import Dataset, open_dataset
from pepperscene.dataset.torch_images import torch_images

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
