"""A physically based spectral renderer of sweet-pepper plants: labelled, radiometrically calibrated images.

The whole program in one line; every arrow is one function:

    Cultivar -> Plant -> Mesh -> Scene -> render() -> Frame -> Dataset

Names are loaded when first used, so that importing the package costs next to nothing.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

from pepperscene.version import __version__

if TYPE_CHECKING:
    from pepperscene.camera import (
        Camera,
        Developing,
        arc_path,
        load_filter,
        load_flash,
        load_lens,
        load_sensor,
        look_at,
    )
    from pepperscene.classes import CLASS_COLOURS, Instance, OrganClass
    from pepperscene.colour import Comparison, PatchSet, compare, open_patches
    from pepperscene.cultivar import Cultivar, interpolated, load_cultivar
    from pepperscene.dataset import (
        VOID,
        Dataset,
        GrownPlant,
        ImageSet,
        Labelled,
        Recipe,
        Stage,
        Verdict,
        build,
        check,
        export,
        grown,
        load_recipe,
        open_dataset,
        open_images,
        read_image,
        render_frame,
        report,
        torch_images,
        write_image,
    )
    from pepperscene.errors import InputError, OutputError, PepperError, SetupError
    from pepperscene.frame import DEFAULT_OUTPUTS, OUTPUTS, Frame
    from pepperscene.geometry import Contacts, Mesh, Settled, concatenate, mesh_plant, settle, write_mesh
    from pepperscene.grammar import Organ, Plant, grow
    from pepperscene.materials import Surface, greenhouse_surfaces, lambertian, organ_surfaces, twine_surface
    from pepperscene.render import Renderer, render
    from pepperscene.scene import (
        Scene,
        Sky,
        Twine,
        assemble,
        double_row,
        load_cover,
        partly_cloudy,
        uniform_sky,
        with_twine,
    )
    from pepperscene.spectra import Spectrum
    from pepperscene.truth import class_colour, class_from_colour, distance_code, distance_from_code
    from pepperscene.tuning import Tuning, tune, twin_patches

_ROOMS = {
    "camera": (
        "Camera", "Developing", "arc_path", "load_filter", "load_flash", "load_lens", "load_sensor",
        "look_at",
    ),
    "classes": ("CLASS_COLOURS", "Instance", "OrganClass"),
    "colour": ("Comparison", "PatchSet", "compare", "open_patches"),
    "cultivar": ("Cultivar", "interpolated", "load_cultivar"),
    "dataset": (
        "VOID", "Dataset", "GrownPlant", "ImageSet", "Labelled", "Recipe", "Stage", "Verdict", "build",
        "check", "export", "grown", "load_recipe", "open_dataset", "open_images", "read_image",
        "render_frame", "report", "torch_images", "write_image",
    ),
    "errors": ("InputError", "OutputError", "PepperError", "SetupError"),
    "frame": ("DEFAULT_OUTPUTS", "OUTPUTS", "Frame"),
    "geometry": ("Contacts", "Mesh", "Settled", "concatenate", "mesh_plant", "settle", "write_mesh"),
    "grammar": ("Organ", "Plant", "grow"),
    "materials": ("Surface", "greenhouse_surfaces", "lambertian", "organ_surfaces", "twine_surface"),
    "render": ("Renderer", "render"),
    "scene": (
        "Scene", "Sky", "Twine", "assemble", "double_row", "load_cover", "partly_cloudy", "uniform_sky",
        "with_twine",
    ),
    "spectra": ("Spectrum",),
    "truth": ("class_colour", "class_from_colour", "distance_code", "distance_from_code"),
    "tuning": ("Tuning", "tune", "twin_patches"),
}  # fmt: skip
_HOME = {name: room for room, names in _ROOMS.items() for name in names}

__all__ = [
    "CLASS_COLOURS",
    "DEFAULT_OUTPUTS",
    "OUTPUTS",
    "VOID",
    "Camera",
    "Comparison",
    "Contacts",
    "Cultivar",
    "Dataset",
    "Developing",
    "Frame",
    "GrownPlant",
    "ImageSet",
    "InputError",
    "Instance",
    "Labelled",
    "Mesh",
    "Organ",
    "OrganClass",
    "OutputError",
    "PatchSet",
    "PepperError",
    "Plant",
    "Recipe",
    "Renderer",
    "Scene",
    "Settled",
    "SetupError",
    "Sky",
    "Spectrum",
    "Stage",
    "Surface",
    "Tuning",
    "Twine",
    "Verdict",
    "__version__",
    "arc_path",
    "assemble",
    "build",
    "check",
    "class_colour",
    "class_from_colour",
    "compare",
    "concatenate",
    "distance_code",
    "distance_from_code",
    "double_row",
    "export",
    "greenhouse_surfaces",
    "grow",
    "grown",
    "interpolated",
    "lambertian",
    "load_cover",
    "load_cultivar",
    "load_filter",
    "load_flash",
    "load_lens",
    "load_recipe",
    "load_sensor",
    "look_at",
    "mesh_plant",
    "open_dataset",
    "open_images",
    "open_patches",
    "organ_surfaces",
    "partly_cloudy",
    "read_image",
    "render",
    "render_frame",
    "report",
    "settle",
    "torch_images",
    "tune",
    "twin_patches",
    "twine_surface",
    "uniform_sky",
    "with_twine",
    "write_image",
    "write_mesh",
]


def __getattr__(name: str) -> Any:
    """The public name out of its room (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Package(ModuleType):
    """Keeps `pepperscene.render` the function, where importing the room of that name would put the room.

    `from pepperscene.render import ...` still reads from the room.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name in _HOME and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
