"""Export of one plant: its mesh as a file for other programs, and a picture of it."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from pepperscene.atomic import check_can_write, write_files
from pepperscene.building.execution.memory import MEMORY, memory_limits, report_memory_errors, shortage
from pepperscene.building.scenes.plant_size import plant_triangles
from pepperscene.errors import ArgumentError, SetupError
from pepperscene.recipe.plan import check_seed

if TYPE_CHECKING:
    from pepperscene.building.scenes.frame_renderer import RendererFactory
    from pepperscene.cultivar import Cultivar
    from pepperscene.geometry import ContactCounts, Mesh


_MAX_DETAIL: Final = 8.0  # chosen: a plant of ten million triangles
_PER_TRIANGLE: Final = {".obj": 850.0}
_PER_TRIANGLE_BINARY: Final = 260.0
"""Bytes per triangle of the mesh, its file and its picture, by the format; measured 750 and 250."""
_PROCESS, _PICTURE = 300e6, 700e6
"""Bytes of a process that grows a plant, and of the picture; measured 320 MB and 690 MB."""


@dataclass(frozen=True)
class PlantExport:
    """The result of `export_plant`.

    Attributes:
        files: the mesh's file first, then files that it refers to, and the picture if there is one.
        cultivar: its name.
        organs: number of each kind, in the order of their first occurrence on the plant.
        triangles: of the mesh.
        height_m: of the mesh.
        contacts: fruit and blades that still touch.
        seconds: time of growing and meshing.
    """

    files: tuple[Path, ...]
    cultivar: str
    organs: Mapping[str, int]
    triangles: int
    height_m: float
    contacts: ContactCounts
    seconds: float


def export_plant(
    cultivar: str,
    out: str | Path,
    seed: int = 0,
    *,
    detail: float = 1.0,
    until: str | None = None,
    share: float | None = None,
    picture: bool = True,
    quality: str = "standard",
    renderer: RendererFactory | None = None,
) -> PlantExport:
    """Grow one plant and write its mesh, with a picture of the same name that ends in `.png`.

    All files are made before the first is written, and all of them are written or none.

    Args:
        cultivar: shipped name or path.
        out: the mesh's file; its suffix is the format (see `geometry.mesh_files`). Its folder is made if
            missing, existing files are replaced.
        seed: of the plant.
        detail: fineness of the mesh, 1 as in frames.
        until: a cultivar at a later growth stage; the plant is between both.
        share: fraction of the way from the first to the second, in [0, 1]; by default 0.5.
        picture: whether to render one.
        quality: of the picture: "draft", "standard" or "reference".
        renderer: makes the renderer of a scene; None for Mitsuba.

    Raises:
        InputError: an argument or a cultivar is not valid; nothing is written.
        OutputError: a file cannot be written.
        SetupError: the machine cannot render, or has not enough memory; nothing is written.
    """
    from pepperscene.building.scenes.plants import grow_plant, growth_stage
    from pepperscene.geometry import check_mesh_format, mesh_files
    from pepperscene.render import find_quality

    # Check all arguments before anything grows.
    path = Path(out)
    check_mesh_format(path)
    find_quality(quality)
    check_seed(seed)
    if not 0.0 < detail <= _MAX_DETAIL:
        raise ArgumentError("detail", f"must be above 0 and at most {_MAX_DETAIL:g}, not {detail:g}")
    picture_path = path.with_suffix(".png")
    check_can_write(path.parent, [path.name, picture_path.name] if picture else [path.name])

    cultivar_stage = growth_stage(cultivar, until, share)
    _check_memory(cultivar_stage, seed, detail, path.suffix.lower(), has_picture=picture and renderer is None)

    with report_memory_errors():
        # The plant.
        start = time.perf_counter()
        plant = grow_plant(cultivar_stage, seed, detail=detail)
        seconds = time.perf_counter() - start

        # Its files.
        files = mesh_files(plant.mesh, path.name)
        if picture:
            files[picture_path.name] = _picture_file(plant.mesh, cultivar_stage, quality, renderer)
    return PlantExport(
        files=write_files(path.parent, files),
        cultivar=cultivar_stage.name,
        organs=dict(Counter(instance.kind for instance in plant.mesh.instances)),
        triangles=len(plant.mesh.faces),
        height_m=float(np.ptp(plant.mesh.vertices[:, 2])),
        contacts=plant.contacts,
        seconds=seconds,
    )


def _check_memory(cultivar: Cultivar, seed: int, detail: float, suffix: str, *, has_picture: bool) -> None:
    """Raise `SetupError` if the plant and its files do not fit into memory."""
    from pepperscene.render.memory import reserved_address_space

    limits = memory_limits()
    fixed = _PROCESS + (_PICTURE if has_picture else 0.0)
    per_triangle = detail**2 * _PER_TRIANGLE.get(suffix, _PER_TRIANGLE_BINARY)

    def missing(triangles: int) -> str | None:
        return shortage(int(fixed + per_triangle * triangles), reserved_address_space(), limits)

    if not limits:
        return
    figures = missing(plant_triangles(cultivar, seed))
    if figures is not None:
        raise SetupError(
            f"{cultivar.name}: a plant of detail {detail:g} needs {figures}; use a smaller detail, or set "
            f"{MEMORY} if the estimate is wrong"
        )


def _picture_file(mesh: Mesh, cultivar: Cultivar, quality: str, renderer: RendererFactory | None) -> bytes:
    """The picture of a plant as a PNG file."""
    from PIL import Image

    from pepperscene.building.scenes.portrait import portrait

    stream = BytesIO()
    image = Image.fromarray(portrait(mesh, cultivar, quality, renderer))
    image.save(stream, format="PNG", optimize=True)
    return stream.getvalue()
