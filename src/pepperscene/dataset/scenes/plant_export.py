"""One plant by itself: its mesh as a file for other programs, and a picture beside it."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.store.atomic import atomic_write
from pepperscene.dataset.store.folder import check_can_create, make_folder, remove
from pepperscene.errors import ArgumentError, OutputError

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar
    from pepperscene.dataset.scenes.frame_renderer import RendererFactory
    from pepperscene.geometry import ContactCounts
    from pepperscene.materials import Surface


_FINEST: Final = 8.0  # chosen: a plant of ten million triangles
_NM: Final = np.arange(380.0, 781.0, 5.0)


@dataclass(frozen=True)
class PlantExport:
    """What `export_plant` made.

    Attributes:
        files: the mesh's file first, what belongs beside it, and the picture if one was wanted.
        cultivar: its name.
        organs: how many of each kind, in the order in which they first stand on the plant.
        triangles: of the mesh.
        height_m: of the mesh.
        contacts: what still touches.
        seconds: that growing and meshing took.
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

    All files are made before the first is written, and each is whole or not there.

    Args:
        cultivar: a shipped cultivar's name, or the path of a file.
        out: the mesh's file; its ending tells the format (see `geometry.mesh_files`). Its folder is made when
            missing, files that are there are replaced.
        seed: of the plant.
        detail: fineness of the mesh, 1 as in frames.
        until: a second cultivar, of a later date; the plant then stands between both.
        share: how far it has come from the first to the second, in [0, 1]; one half if left out.
        picture: whether to render one.
        quality: of the picture: "draft", "standard" or "reference".
        renderer: makes the renderer of a scene; None for Mitsuba.

    Raises:
        InputError: an argument or a cultivar is not valid; nothing is written.
        OutputError: a file cannot be written there.
        SetupError: the machine cannot render; nothing is written.
    """
    # All that can be wrong with the arguments comes to light before anything grows.
    from pepperscene.dataset.scenes.plants import grow_plant, growth_stage
    from pepperscene.geometry import check_mesh_format, mesh_files
    from pepperscene.render import find_quality

    path = Path(out)
    check_mesh_format(path)
    find_quality(quality)
    _check(seed, detail, until, share)
    picture_path = path.with_suffix(".png")
    _examine((path, picture_path) if picture else (path,))

    # The plant.
    start = time.perf_counter()
    law = growth_stage(cultivar, until, share)
    plant = grow_plant(law, seed, detail=detail)
    seconds = time.perf_counter() - start

    # Its files, as bytes.
    files = mesh_files(plant.mesh, path.name, surface_colours(_surfaces(law)))
    if picture:
        from pepperscene.dataset.scenes.portrait import portrait

        files[picture_path.name] = _png(portrait(plant.mesh, law, quality, renderer))
    try:
        written = _write(path.parent, files)
    except OSError as fault:
        where = fault.filename or path
        raise OutputError(f"{where}: cannot be written ({fault.strerror or fault})") from None
    return PlantExport(
        files=written,
        cultivar=law.name,
        organs=dict(Counter(one.kind for one in plant.mesh.instances)),
        triangles=len(plant.mesh.faces),
        height_m=float(np.ptp(plant.mesh.vertices[:, 2])),
        contacts=plant.contacts,
        seconds=seconds,
    )


def surface_colours(surfaces: Iterable[Surface]) -> dict[str, NDArray[np.float64]]:
    """`(s, 3)` linear sRGB by surface, one row for each tabulated pigment state: the front's body in D65.

    The CIE 1931 observer sees the diffuse reflectance; a perfect diffuser would be 1, 1, 1.
    """
    from pepperscene.spectra import colour_science

    colour = colour_science()
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    matching = np.stack([np.interp(_NM, observer.wavelengths, column) for column in observer.values.T])
    light = colour.SDS_ILLUMINANTS["D65"]
    weights = matching * np.interp(_NM, light.wavelengths, light.values)
    weights /= weights[1].sum()
    found = {}
    for surface in surfaces:
        front = surface.reflectance[:, 0]
        seen = np.stack([np.interp(_NM, surface.wavelength_nm, row) for row in front])
        rgb = colour.XYZ_to_RGB(seen @ weights.T, "sRGB", apply_cctf_encoding=False)
        found[surface.name] = np.clip(np.asarray(rgb, dtype=float), 0.0, 1.0)
    return found


def _surfaces(cultivar: Cultivar) -> Iterable[Surface]:
    from pepperscene.materials import organ_surfaces

    return organ_surfaces(cultivar, _NM).values()


def _check(seed: int, detail: float, until: str | None, share: float | None) -> None:
    """Raise the `InputError` that tells which argument is wrong, if one is."""
    if not 0 <= seed < 2**63:
        raise ArgumentError("seed", f"must be at least 0 and below 2^63, not {seed}")
    if not 0.0 < detail <= _FINEST:
        raise ArgumentError("detail", f"must be above 0 and at most {_FINEST:g}, not {detail:g}")
    if share is not None and not 0.0 <= share <= 1.0:
        raise ArgumentError("share", f"must lie in [0, 1], not {share:g}")
    if share is not None and until is None:
        raise ArgumentError("share", "needs --until, the cultivar that it is the share of the way to")


def _examine(paths: Iterable[Path]) -> None:
    """Raise the `OutputError` that tells why files cannot be written there, if there is a reason."""
    for path in paths:
        check_can_create(path.parent)
        try:
            standing = path.is_dir()
        except OSError as fault:
            raise OutputError(f"{path}: cannot be written ({fault.strerror})") from None
        if "\0" in path.name:
            raise OutputError(f"{str(path)!r}: is not a possible name of a file")
        if standing:
            raise OutputError(f"{path}: is a folder where a file is to be written")


def _write(folder: Path, files: Mapping[str, bytes]) -> tuple[Path, ...]:
    """Write all files under other names, and only when all are whole let them take their places."""
    made: list[Path] = []
    try:
        make_folder(folder, made)
        with ExitStack() as stack:
            for name, content in files.items():
                stack.enter_context(atomic_write(folder / name)).write_bytes(content)
    except BaseException:
        remove(made)
        raise
    return tuple(folder / name for name in files)


def _png(picture: NDArray[Any]) -> bytes:
    from PIL import Image

    stream = BytesIO()
    Image.fromarray(picture).save(stream, format="PNG", optimize=True)
    return stream.getvalue()
