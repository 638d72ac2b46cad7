"""Data sets: a recipe defines one, a plan numbers its frames, a build renders them, a report shows them."""

from pepperscene.dataset.check import CheckResult, Finding, check_dataset
from pepperscene.dataset.execution.build import BuildProgress, BuildResult, build
from pepperscene.dataset.execution.job import BuildOptions
from pepperscene.dataset.execution.progress_bar import ProgressBar
from pepperscene.dataset.execution.single_frame import render_frame
from pepperscene.dataset.export import FORMATS, ExportResult, Splits, export_dataset
from pepperscene.dataset.readers import open_images
from pepperscene.dataset.readers.image_set import VOID, ImageSet, LabelledImage
from pepperscene.dataset.readers.torch_augment import Augmentation
from pepperscene.dataset.readers.torch_augment_colour import ColourJitter, RandomBlur, RandomJpeg, RandomNoise
from pepperscene.dataset.readers.torch_augment_geometry import RandomFlip, RandomResizedCrop
from pepperscene.dataset.readers.torch_augment_step import AugmentationStep
from pepperscene.dataset.readers.torch_images import collate_detections, torch_detections, torch_images
from pepperscene.dataset.recipe.load import load_recipe, parse_changes, resolve_recipe
from pepperscene.dataset.recipe.plan import FrameSpec, Plan
from pepperscene.dataset.recipe.recipe import Recipe
from pepperscene.dataset.recipe.resolved import ResolvedRecipe
from pepperscene.dataset.report import ReportFiles, write_report
from pepperscene.dataset.scenes.frame_renderer import FrameRenderer
from pepperscene.dataset.scenes.plants import GrownPlant, grow_plant
from pepperscene.dataset.store.dataset import Dataset, open_dataset
from pepperscene.dataset.store.images import read_image, write_image

__all__ = [
    "FORMATS",
    "VOID",
    "Augmentation",
    "AugmentationStep",
    "BuildOptions",
    "BuildProgress",
    "BuildResult",
    "CheckResult",
    "ColourJitter",
    "Dataset",
    "ExportResult",
    "Finding",
    "FrameRenderer",
    "FrameSpec",
    "GrownPlant",
    "ImageSet",
    "LabelledImage",
    "Plan",
    "ProgressBar",
    "RandomBlur",
    "RandomFlip",
    "RandomJpeg",
    "RandomNoise",
    "RandomResizedCrop",
    "Recipe",
    "ReportFiles",
    "ResolvedRecipe",
    "Splits",
    "build",
    "check_dataset",
    "collate_detections",
    "export_dataset",
    "grow_plant",
    "load_recipe",
    "open_dataset",
    "open_images",
    "parse_changes",
    "read_image",
    "render_frame",
    "resolve_recipe",
    "torch_detections",
    "torch_images",
    "write_image",
    "write_report",
]
