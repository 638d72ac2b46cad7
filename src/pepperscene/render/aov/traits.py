"""Traits of the tissue at each pixel: chlorophyll, carotenoids, water, ripeness and leaf age.

The light of a frame sees the two spectra of a surface that are next to the pigment state of a point, mixed in
proportion (`pepperscene.render.surface.optics`). A map has the contents behind these two spectra, mixed in
the same proportion, at the point behind the centre of the pixel. Such a mixture is tissue of both kinds side
by side, so the content is that of the area. The state is that of the vertices, with pattern and ageing of the
texture, which light does not filter either. Residue and gloss change no content.

A point has no value (nan) where its surface has no such trait, where the colour comes from a scan, and in the
background.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.geometry.mesh import PIGMENTS
from pepperscene.materials.tissue import tissue_states
from pepperscene.render.aov.labels import Hits, SurfacePoints, surface_points
from pepperscene.render.kernel.scene import check_surfaces
from pepperscene.scene import Scene

FloatArray = NDArray[np.float64]


class SceneTraits:
    """The traits of a scene's surfaces.

    Args:
        scene: with its surfaces.

    Raises:
        ValueError: the scene has no surfaces.
    """

    def __init__(self, scene: Scene) -> None:
        check_surfaces(scene)
        self._mesh, self._surfaces = scene.mesh, scene.surfaces
        appearances = scene.mesh.appearances
        self._ageing = np.array([item.ageing for item in appearances])
        self._variant = np.array([item.variant for item in appearances], np.int64)

    def images(self, hits: Hits, camera: Camera, names: Collection[str]) -> dict[str, NDArray[np.float32]]:
        """`(h, w)` maps of some of the `TRAIT_OUTPUTS`, behind the pixels' centres, in the rows of the hits.

        Args:
            hits: of the camera's labels.
            camera: of the image.
            names: of the maps.
        """
        face = hits.face.ravel()
        hit = np.flatnonzero((face >= 0) & ~self._scanned_at(face))
        surface = self._mesh.face_surface[face[hit]]
        images = {name: np.full(face.size, np.nan, np.float32) for name in names}
        if "leaf_age" in images:
            is_blade = np.array([one.is_blade for one in self._surfaces])
            blades = hit[is_blade[surface]]
            images["leaf_age"][blades] = self._ageing[self._mesh.face_appearance[face[blades]]]
        has_content = np.array([not one.contents.keys().isdisjoint(names) for one in self._surfaces])
        for points in surface_points(self._mesh, hits, camera, hit[has_content[surface]]):
            self._fill(images, points)
        return {name: image.reshape(hits.face.shape) for name, image in images.items()}

    def _scanned_at(self, face: NDArray[np.int64]) -> NDArray[np.bool_]:
        """`(n,)` whether the colours of triangles come from a scan."""
        mesh = self._mesh
        if mesh.colour is None:
            return np.zeros(face.size, dtype=bool)
        # All vertices of an organ have scanned colours, or none.
        return np.asarray(mesh.colour[mesh.faces[face, 0], 0] > 0.5 * PIGMENTS)

    def _fill(self, images: dict[str, NDArray[np.float32]], points: SurfacePoints) -> None:
        """Write the contents at points, surface by surface."""
        state, uv = points.interpolate(self._mesh.state), points.interpolate(self._mesh.uv)
        appearance = self._mesh.face_appearance[points.face]
        number = self._mesh.face_surface[points.face]
        for index in np.unique(number).tolist():
            surface, at = self._surfaces[index], np.flatnonzero(number == index)
            organ = appearance[at]
            mixed = tissue_states(surface, state[at], uv[at], self._variant[organ], self._ageing[organ])
            for name, amounts in surface.contents.items():
                if name in images:
                    images[name][points.pixels[at]] = np.interp(mixed, surface.states, amounts)
