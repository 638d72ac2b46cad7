"""Export of the scene of a frame to a file for simulators and other programs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pepperscene.atomic import canonical_json, check_can_write, write_files
from pepperscene.building.memory import report_memory_errors
from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.errors import ArgumentError, InputError
from pepperscene.export.run import new_folder
from pepperscene.export.simulators.contents import SceneContents, scene_contents
from pepperscene.geometry.glb import encode_glb
from pepperscene.geometry.natural_colours import NATURAL_NM
from pepperscene.libraries import import_library
from pepperscene.materials import stand_surfaces
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.recipe.resolve.resolved import ResolvedRecipe
from pepperscene.scene import Scene

if TYPE_CHECKING:
    from pepperscene.camera import Camera

SUFFIXES: Final = (".glb", ".usd", ".usda", ".usdc", ".sdf")


def export_scene(
    scene: Scene | Recipe | ResolvedRecipe | str | Path,
    out: str | Path,
    frame: int | None = None,
    *,
    camera: Camera | None = None,
    allow_code: bool = False,
    on_stage: Callable[[str], None] | None = None,
) -> tuple[Path, ...]:
    """Write the whole scene of a frame for another program: plants, greenhouse, truth of fruit, colours.

    - `.glb`: a node with a pose for each plant and organ; class, instance, ripeness and cut point as extras;
      natural colours as images; y up, as glTF requires.
    - `.usd`, `.usda`, `.usdc`: the same in metres and z up, with semantic labels, rigid bodies of fruit on
      joints that break, sun, sky and camera; needs the extra `usd`. Images are beside the file.
    - `.sdf`: a folder of the name without the suffix with a model for Gazebo.

    Instance numbers are those of the instance image of the frame. A JSON of the same name has all poses.

    Args:
        scene: a scene, or a recipe, the name of a shipped one, or a path.
        out: the file; its suffix is the format. Its folder is made if missing, existing files are replaced.
            The folder of an SDF must be new or empty.
        frame: index of the frame of a recipe; None for the first that it selects.
        camera: of a scene; a recipe has its own.
        allow_code: whether the recipe's code may run.
        on_stage: called with the name of each stage when it begins.

    Returns:
        The files: the scene's own first, then its images or meshes, and the JSON last.

    Raises:
        InputError: an argument, the recipe or a file that it names is not valid; nothing is written.
        OutputError: a file cannot be written.
        SetupError: the library of a format is not installed, or there is not enough memory.
    """
    path, stage = Path(out), on_stage or (lambda _: None)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(path, f"must end in {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}")
    if suffix.startswith(".usd"):
        import_library("pxr.UsdSemantics", "usd")
    check_can_write(path.parent, [] if suffix == ".sdf" else [path.name, path.with_suffix(".json").name])
    with report_memory_errors():
        contents = _contents(scene, frame, camera, allow_code, stage)
        stage("baking colours and writing files")
        return _write(contents, path, suffix)


def _contents(
    scene: Scene | Recipe | ResolvedRecipe | str | Path,
    frame: int | None,
    camera: Camera | None,
    allow_code: bool,
    on_stage: Callable[[str], None],
) -> SceneContents:
    """The content of the files, of a scene or of the frame of a recipe."""
    if isinstance(scene, Scene):
        if frame is not None:
            raise ArgumentError("frame", "applies to recipes, not to a scene")
        return scene_contents(scene, camera)
    if camera is not None:
        raise ArgumentError("camera", "applies to scenes; a recipe has its own")
    resolved = resolve_recipe(scene, allow_code=allow_code)
    resolved.check_code()
    spec = resolved.recipe.plan.first_frame(frame)
    on_stage("growing plants")
    # Another program may look at what the recipe's cameras do not see.
    frames = FrameRenderer(resolved, culled=False)
    view = frames.camera(spec, traced=False)
    about: Mapping[str, Any] = {
        "recipe": resolved.recipe.name,
        "seed": resolved.recipe.seed,
        "frame": spec.index,
    }
    grown = frames.current_scene or frames.scene(spec, traced=False)
    contents = scene_contents(grown, view, frames.sky(spec), about)
    if (stand := resolved.recipe.stand) is None:
        return contents
    surfaces = stand_surfaces(NATURAL_NM, stand.pot_colour, stand.backdrop_colour)
    del surfaces["chart"]  # a small image has no markers
    return replace(contents, surfaces=surfaces)


def _write(contents: SceneContents, path: Path, suffix: str) -> tuple[Path, ...]:
    """Write all files of a scene, or none."""
    description = canonical_json(contents.to_json())
    if suffix == ".sdf":
        from pepperscene.export.simulators.sdf import write_model

        folder = path.with_suffix("")
        with new_folder(folder, None) as temporary:
            names = write_model(contents, temporary, folder.name)
            (temporary / "scene.json").write_bytes(description)
        return tuple(folder / name for name in (*names, "scene.json"))
    if suffix == ".glb":
        files = {path.name: encode_glb(contents.mesh, contents.nodes, baked=contents.colours)}
    else:
        from pepperscene.export.simulators.usd import usd_files

        files = usd_files(contents, path.name)
    files[path.with_suffix(".json").name] = description
    # Other files are complete before the scene's own appears.
    written = write_files(path.parent, {name: files[name] for name in reversed(files)})
    return written[::-1]
