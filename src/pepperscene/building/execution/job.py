"""The job of a build: render and write its frames, in any process."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np

from pepperscene.atomic import write_errors
from pepperscene.building.execution.options import BuildOptions as BuildOptions
from pepperscene.building.memory import check_fits, frame_memory
from pepperscene.building.scenes.frame_renderer import FrameRenderer, RendererFactory
from pepperscene.building.scenes.scene_builder import SceneBuilder
from pepperscene.dataset.store.dataset import FORMAT
from pepperscene.dataset.store.folder import OutputFolder
from pepperscene.dataset.store.frame_json import FrameStatus
from pepperscene.dataset.store.manifest import Row
from pepperscene.errors import InputError
from pepperscene.frame import Frame
from pepperscene.interrupts import raise_if_interrupted
from pepperscene.outputs import check_outputs
from pepperscene.recipe.plan import FrameSpec, frame_seed
from pepperscene.recipe.recipe import Recipe, digest
from pepperscene.recipe.resolve.camera_views import check_further_cameras
from pepperscene.recipe.resolve.frame_setups import camera_name, frame_values
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.recipe.resolve.resolved import ResolvedRecipe
from pepperscene.recipe.views_tables import FunctionViews
from pepperscene.truth import class_pixel_counts
from pepperscene.units import file_values
from pepperscene.version import __version__

if TYPE_CHECKING:
    from pepperscene.render import Quality

_IMAGE_THREADS: Final = 4
"""Chosen: images that are written at a time; each waits for the disk for a third of its time."""


@dataclass(frozen=True, eq=False)
class BuildJob:
    """Everything that the frames of a build depend on except their indices; it can be pickled."""

    recipe: ResolvedRecipe
    folder: Path
    outputs: tuple[str, ...]
    quality: str = "standard"
    target_error: float | None = None
    renderer: RendererFactory | None = None

    @classmethod
    def create(
        cls,
        recipe: Recipe | ResolvedRecipe | str | Path,
        folder: str | Path,
        outputs: Sequence[str],
        options: BuildOptions,
    ) -> BuildJob:
        """Check the arguments of a build and load its recipe; raises `InputError` if one is not valid."""
        from pepperscene.render import resolve_quality

        names = check_outputs(outputs)
        resolve_quality(options.quality, options.target_error)
        resolved = resolve_recipe(recipe, seed=options.seed, allow_code=options.allow_code)
        check_further_cameras(resolved.recipe, names)
        resolved.camera.sensor.check_outputs(names)
        path = Path(folder).absolute()
        return cls(resolved, path, names, options.quality, options.target_error, options.renderer)

    @cached_property
    def resolved_quality(self) -> Quality:
        """The quality with the job's target error."""
        from pepperscene.render import resolve_quality

        return resolve_quality(self.quality, self.target_error)

    @cached_property
    def memory_bytes(self) -> float:
        """Bytes that a process takes to make frames."""
        recipe, in_strips = self.recipe, self.resolved_quality.integrator != "path"
        triangles = SceneBuilder(recipe.recipe, recipe.cultivar, processes=1).estimate_triangles()
        return frame_memory(recipe.camera, self.outputs, triangles, recipe.depth_camera, in_strips=in_strips)

    def check_memory(self, processes: int = 1) -> None:
        """Check that processes of this machine can make frames; errors as of `check_fits`.

        Jobs with a renderer of their own are not checked.
        """
        if self.renderer is None:
            camera, row = self.recipe.camera, self.recipe.recipe.row
            subject = (
                f"{self.recipe.recipe.name}: a frame of {camera.width} x {camera.height} pixels and "
                f"{row.plants_front + row.plants_back} plants with the outputs {', '.join(self.outputs)}"
            )
            check_fits(self.memory_bytes, subject, "use a smaller sensor or fewer outputs", processes)

    @cached_property
    def info(self) -> dict[str, Any]:
        """Content of `dataset.json`: everything that frames depend on except their index."""
        quality, identity, expect = self.quality, self.recipe.identity, self.recipe.recipe.expect
        if self.target_error is not None:
            quality += f", target error {self.target_error:g}"
        info: dict[str, Any] = {"format": FORMAT, "version": __version__, "quality": quality}
        info |= {"recipe_sha256": digest(identity), **identity}
        if self.recipe.spectra_notes:
            info["measured_spectra"] = list(self.recipe.spectra_notes)
        if expect is not None:
            info["expect"] = file_values(expect, mode="json", exclude_none=True)
        return info

    def _variation(self, spec: FrameSpec) -> dict[str, Any]:
        """Moment, twin, rig camera and drawn values of a frame; only those that the recipe has."""
        recipe, described = self.recipe.recipe, dict[str, Any]()
        if recipe.twins:
            described |= {"moment": spec.moment, "twin": spec.twin}
        if recipe.rig:
            described |= {"moment": spec.moment, "rig_camera": camera_name(recipe, spec)}
        _, drawn = frame_values(recipe, spec)
        return {**described, "drawn": drawn} if drawn else described

    def frame_metadata(self, frame: Frame, spec: FrameSpec) -> dict[str, Any]:
        """A frame's JSON without `outputs`; it is the same in every run."""
        metadata = {str(key): value for key, value in frame.metadata.items()}
        seed = self.recipe.recipe.seed
        metadata |= {"index": spec.index, "set": spec.set, "rotation": spec.rotation, "step": spec.step}
        metadata |= self._variation(spec)
        metadata |= {"seed": frame_seed(seed, spec.index), "recipe_seed": seed}
        if "class" in frame.images:
            metadata["class_pixels"] = class_pixel_counts(frame.images["class"])
        return metadata


@dataclass(frozen=True)
class FrameDone:
    """Report of a complete frame, with its row of the manifest; `made` is False if it existed already."""

    index: int
    made: bool
    row: Row


OnFrame = Callable[[FrameDone], None]


class FrameMaker:
    """Makes frames of a job in this process; each is written in the background while the next is rendered.

    A label frame takes 29 ms like this, 33 if one thread writes its images, and 36 without the background
    (two cores). Memory holds the images of two frames, and frames are complete in the given order. On leaving
    the `with` block, also by an exception, the frame that is being written is finished first.

    Args:
        job: of the build.
        worker: name of this process, for the manifest.
        eager: report a frame at once, in the writing thread; by default in this one, after the next frame.
        renderer: of the job's recipe, if there is one already.
    """

    def __init__(
        self, job: BuildJob, worker: str = "", *, eager: bool = False, renderer: FrameRenderer | None = None
    ) -> None:
        self._job, self._worker, self._eager = job, worker, eager
        self._renderer = renderer or FrameRenderer(job.recipe, job.renderer)
        self._folder = OutputFolder(job.folder, job.info)
        self._prepared: set[str] = set()
        # Two pools, because a pool that ends starts nothing more: frames end first, then their images.
        self._frame_thread = ThreadPoolExecutor(1, "write frame")
        self._image_threads = ThreadPoolExecutor(_IMAGE_THREADS, "write image")
        self._writing: Future[FrameDone] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._frame_thread.shutdown()
        self._image_threads.shutdown()

    def make(
        self, indices: Iterable[int], on_frame: OnFrame, stop: Callable[[], bool] = lambda: False
    ) -> None:
        """Make what is missing of some frames.

        Args:
            indices: of the frames.
            on_frame: called for each frame in order, once it is complete.
            stop: called before each frame; True ends the work, after the frames that were started.
        """
        for index in indices:
            raise_if_interrupted()
            if stop():
                break
            start = time.perf_counter()
            status = self._folder.dataset.intact(index)
            missing = tuple(name for name in self._job.outputs if name not in status.outputs)
            if not missing:
                self._finish(on_frame)
                on_frame(FrameDone(index, False, status.row()))
                continue
            # The frame before is written meanwhile.
            spec = self._job.recipe.recipe.plan.frame(index)
            frame = self._renderer.render(spec, missing, self._job.resolved_quality)
            _check_same_pose(frame, status, index, self._job.recipe.recipe)
            render_s = time.perf_counter() - start
            self._finish(on_frame)
            self._writing = self._frame_thread.submit(
                self._write, spec, frame, missing, status, render_s, on_frame
            )
        self._finish(on_frame)

    def _finish(self, on_frame: OnFrame) -> None:
        """Wait until the frame that is being written is complete, or raise why it could not be written."""
        writing, self._writing = self._writing, None
        if writing is not None:
            done = writing.result()
            if not self._eager:
                on_frame(done)

    def _write(
        self,
        spec: FrameSpec,
        frame: Frame,
        outputs: tuple[str, ...],
        status: FrameStatus,
        render_s: float,
        on_frame: OnFrame,
    ) -> FrameDone:
        dataset, start = self._folder.dataset, time.perf_counter()
        metadata = self._job.frame_metadata(frame, spec)
        with write_errors(dataset.folder):
            # Folders are prepared once per output, because looking for temporary files reads them completely.
            if not self._prepared.issuperset(outputs):
                self._folder.prepare(outputs)
                self._prepared.update(outputs)
            images = {name: frame.images[name] for name in outputs}
            try:
                written = dataset.commit(spec.index, images, metadata, status, self._image_threads)
            except FileNotFoundError:
                # Another build that was interrupted before its first frame has removed the empty folders.
                self._folder.prepare(outputs)
                written = dataset.commit(spec.index, images, metadata, status, self._image_threads)
        timing = {"render_s": render_s, "write_s": time.perf_counter() - start, "worker": self._worker}
        done = FrameDone(spec.index, True, {**written.row(), **timing})
        if self._eager:
            on_frame(done)
        return done


def _check_same_pose(frame: Frame, status: FrameStatus, index: int, recipe: Recipe) -> None:
    """Check that further outputs of a frame have the pose of those that it has already.

    Only a user's function can give another one: if it draws from random numbers of its own, or was changed.

    Raises:
        InputError: the pose is another one.
    """
    recorded = status.metadata.get("camera")
    before = recorded.get("pose") if isinstance(recorded, dict) else None
    if not status.outputs or before is None or not isinstance(recipe.views, FunctionViews):
        return
    pose = frame.metadata["camera"]["pose"]
    if np.shape(before) != (4, 4) or not np.allclose(before, pose, rtol=0, atol=1e-9):
        problem = (
            f"gives another pose for frame {index} than the recorded one, so outputs cannot be added; "
            "it must draw random numbers from rng only"
        )
        raise InputError(recipe.views.file, problem, key=recipe.views.function)
