"""The organs of a mesh as bodies that can be turned: points on them, feet, kinship, boxes around them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.geometry.contacts.samples import Patches, counted, filling, patched
from pepperscene.geometry.mesh import Mesh

Vectors = NDArray[np.float64]
Points = NDArray[np.float32]
Indices = NDArray[np.intp]

# As plain numbers: members of an enumeration are slow to look up. What grows without a class is a flower.
FLOWER, LEAF, FRUIT, STALK, STEM, SHOOT, CORD = (
    int(item)
    for item in (
        OrganClass.BACKGROUND, OrganClass.LEAF, OrganClass.PEPPER, OrganClass.PEDUNCLE, OrganClass.STEM,
        OrganClass.SHOOT, OrganClass.WIRE,
    )
)  # fmt: skip


_BLOCK: Final = 128  # boxes compared at a time, chosen


class Organs:
    """The instances of a mesh, each a rigid body that stands where its turns so far have brought it.

    Args:
        mesh: whose instances stand for organs; a parent's number need not be below its children's.

    Attributes:
        parent: `(n,)` which organ each grows out of, -1 for none.
        organ_class: `(n,)`.
        plant: `(n,)`.
        solid: `(n,)` whether it is a body: it has triangles and is no scenery, which is what has no class and
            grows on nothing.
        low, high: `(n, 3)` metres, the corners of the box around each organ, now.
        turns: how many turns there have been.
        stamp: `(n,)` how many turns there had been when it was turned last; 0 for what never was.
        rotation, shift: `(n, 3, 3)` and `(n, 3)`: points stand now at rotation @ point as grown + shift.
        laid: the patches of points that were laid so far.
        patch_first, patch_count: `(n,)` where each organ's patches start, how many it has; -1 for none yet.

    Raises:
        ValueError: two instances share vertices, so that one cannot turn without the other.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.parent = np.array([item.parent for item in mesh.instances], dtype=np.intp)
        self.organ_class = np.array([int(item.organ_class) for item in mesh.instances], dtype=np.intp)
        self.plant = np.array([item.plant for item in mesh.instances], dtype=np.intp)
        runs = mesh.face_runs
        self._faces = mesh.faces if runs.order is None else mesh.faces[runs.order]
        self._face_first, self._face_stop = runs.first, runs.stop
        self._order, self._first, self._stop = mesh.vertex_runs.order, mesh.vertex_runs.first, mesh.vertex_runs.stop
        scenery = (self.organ_class == FLOWER) & (self.parent < 0)
        self.solid = (self._stop > self._first) & ~scenery
        self.low, self.high = self._boxes()
        self._as_grown = self.low.astype(np.float32), (self.high - self.low).max(axis=1).astype(np.float32)
        self.stamp = np.zeros(len(self.parent), dtype=np.intp)
        self.turns = 0
        # An organ's points stand now at rotation @ point as grown + shift.
        self.rotation = np.tile(np.eye(3), (len(self.parent), 1, 1))
        self.shift = np.zeros((len(self.parent), 3))
        # Patches as they stand, in the order in which they were asked for.
        self.laid, self._used = Patches.room(0), 0
        self.patch_first = np.zeros(len(self.parent), dtype=np.intp)
        self.patch_count = np.full(len(self.parent), -1)
        self._feet: dict[int, Vectors] = {}

    def __len__(self) -> int:
        return len(self.parent)

    def of_class(self, *classes: int) -> Indices:
        """Indices of the bodies of some classes."""
        return np.flatnonzero(np.isin(self.organ_class, classes) & self.solid)

    def in_box(self, low: Vectors, high: Vectors, margin: float = 0.0) -> NDArray[np.bool_]:
        """`(..., n)` which bodies' boxes come nearer to a box than `margin` metres along every axis.

        Args:
            low: `(..., 3)` and
            high: `(..., 3)` metres, its corners.
            margin: metres.
        """
        found = self.solid.copy() if np.ndim(low) == 1 else np.tile(self.solid, (*low.shape[:-1], 1))
        for axis in range(3):
            found &= self.low[:, axis] < high[..., axis, None] + margin
            found &= self.high[:, axis] > low[..., axis, None] - margin
        return found

    def meeting(self, some: Indices, others: Indices, margin: float) -> tuple[Indices, Indices]:
        """Places of those of some organs and of others whose boxes come nearer than `margin` metres."""
        rows, columns = [], []
        # Only what lies between the first and the last x is compared with a few at a time.
        order = some[np.argsort(self.low[some, 0], kind="stable")]
        place = np.argsort(self.low[some, 0], kind="stable")
        low, high = self.low[others] - margin, self.high[others] + margin
        for start in range(0, len(order), _BLOCK):
            block = order[start : start + _BLOCK]
            near = np.flatnonzero(
                (low[:, 0] < self.high[block, 0].max()) & (high[:, 0] > self.low[block, 0].min())
            )
            meet = np.ones((len(block), len(near)), dtype=bool)
            for axis in range(3):
                meet &= self.low[block, axis, None] < high[near, axis]
                meet &= self.high[block, axis, None] > low[near, axis]
            row, column = np.nonzero(meet)
            rows.append(place[start + row])
            columns.append(near[column])
        empty = np.empty(0, dtype=np.intp)
        return np.concatenate([empty, *rows]), np.concatenate([empty, *columns])

    def vertices(self, organ: int) -> Points:
        """`(v, 3)` an organ's vertices as grown."""
        return self.mesh.vertices[self._rows(organ)]

    def along(self, organ: int) -> NDArray[np.float32]:
        """`(v,)` how far each of an organ's vertices stands along it: 0 at its base, 1 at its tip."""
        return self.mesh.uv[self._rows(organ), 1]

    def triangles(self, organs: Sequence[int]) -> tuple[Points, Indices]:
        """`(f, 3, 3)` the triangles of some organs as grown, and `(f,)` the place of each one's organ."""
        runs = [self._faces[self._face_first[one] : self._face_stop[one]] for one in organs]
        owner = np.repeat(np.arange(len(runs)), [len(run) for run in runs])
        return self.mesh.vertices[np.concatenate(runs)], owner

    def pose(self, organ: int) -> tuple[Vectors, Vectors]:
        """`(3, 3)` and `(3,)`: an organ's points stand now at rotation @ point as grown + shift."""
        return self.rotation[organ], self.shift[organ]

    def foot(self, organ: int) -> Vectors:
        """`(3,)` where an organ starts, now."""
        if organ not in self._feet:
            along = self.along(organ)
            base = self.vertices(organ)[along <= along.min() + 1e-6]
            self._feet[organ] = base.mean(axis=0, dtype=np.float64)
        return np.asarray(self.rotation[organ] @ self._feet[organ] + self.shift[organ])

    def middle(self, organ: int) -> Vectors:
        """`(3,)` the middle of an organ's box, now."""
        return np.asarray(0.5 * (self.low[organ] + self.high[organ]))

    def sample(self, organs: Iterable[int]) -> None:
        """Lay patches of points on some organs at once, which is faster than one by one."""
        wanted = np.fromiter(organs, dtype=np.intp)
        missing = np.unique(wanted[self.patch_count[wanted] < 0])
        if not len(missing):
            return
        corners, owner = self.triangles(missing.tolist())
        more, triangle = filling(corners)
        vertices = [self.vertices(organ) for organ in missing.tolist()]
        owner = np.concatenate(
            [np.repeat(np.arange(len(missing)), [len(one) for one in vertices]), owner[triangle]]
        )
        laid, count = patched(
            np.concatenate([*vertices, more]), owner, self._as_grown[0][missing], self._as_grown[1][missing]
        )
        if self._used + len(laid) > len(self.laid):
            more_room = Patches.room(2 * (self._used + len(laid)))
            more_room.put(0, self.laid.part(slice(self._used)))
            self.laid = more_room
        first = self._used + np.cumsum(count) - count
        self.laid.put(self._used, laid)
        self._used += len(laid)
        self.patch_first[missing], self.patch_count[missing] = first, count
        for organ in missing.tolist():
            if self.stamp[organ]:
                self._move_patches(organ, *self.pose(organ))

    def _move_patches(self, organ: int, rotation: Vectors, shift: Vectors) -> Points:
        """Move an organ's patches; returns their points, `(p, 3)`."""
        first = int(self.patch_first[organ])
        moved = self.laid.part(slice(first, first + int(self.patch_count[organ]))).moved(rotation, shift)
        self.laid.put(first, moved)
        return moved.points.reshape(-1, 3)

    def patches(self, organs: Sequence[int]) -> tuple[Patches, Indices, Indices]:
        """Points on the surfaces of some organs, now, nowhere far apart (see `contact_points`), in patches.

        Returns:
            All patches that were laid so far; `(m,)` those of the organs, organ after organ; and `(m,)` the
            place of each one's organ.
        """
        some = np.asarray(organs, dtype=np.intp)
        self.sample(some)
        place, number = counted(self.patch_count[some])
        return self.laid, self.patch_first[some][place] + number, place

    def subtree(self, root: int) -> list[int]:
        """An organ and all that grows on it, in order of their numbers."""
        found, left = [], [root]
        while left:
            organ = left.pop()
            found.append(organ)
            left += self._children[organ]
        return sorted(found)

    def ancestors(self, organ: int) -> list[int]:
        """What an organ grows on, nearest first."""
        found = []
        above = int(self.parent[organ])
        while above >= 0:
            found.append(above)
            above = int(self.parent[above])
        return found

    def turn(self, organs: Iterable[int], rotation: Vectors, shift: Vectors) -> None:
        """Move organs: every point p of theirs goes to rotation @ p + shift."""
        self.turns += 1
        for organ in organs:
            old, moved = self.pose(organ)
            self.rotation[organ], self.shift[organ] = rotation @ old, rotation @ moved + shift
            self.stamp[organ] = self.turns
            if not self.solid[organ]:
                continue
            if self.patch_count[organ] < 0:
                now = self._moved(organ, self.vertices(organ))
            else:
                now = self._move_patches(organ, rotation, shift)
            self.low[organ], self.high[organ] = now.min(axis=0), now.max(axis=0)

    def turned_mesh(self) -> Mesh:
        """The mesh with every organ where it stands now; the very mesh if none was turned."""
        if not self.turns:
            return self.mesh
        vertices, normals = self.mesh.vertices.copy(), self.mesh.normals.copy()
        for organ in np.flatnonzero(self.stamp).tolist():
            rows = self._rows(organ)
            vertices[rows] = self._moved(organ, vertices[rows])
            normals[rows] = (normals[rows] @ self.rotation[organ].T).astype(np.float32)
        return replace(self.mesh, vertices=vertices, normals=normals)

    @cached_property
    def _children(self) -> list[list[int]]:
        children: list[list[int]] = [[] for _ in self.parent]
        for organ, above in enumerate(self.parent.tolist()):
            if above >= 0:
                children[above].append(organ)
        return children

    def _rows(self, organ: int) -> slice | Indices:
        rows = slice(int(self._first[organ]), int(self._stop[organ]))
        return rows if self._order is None else self._order[rows]

    def _moved(self, organ: int, points: Points) -> Points:
        if not self.stamp[organ]:
            return points
        return (points @ self.rotation[organ].T + self.shift[organ]).astype(np.float32)

    def _boxes(self) -> tuple[Vectors, Vectors]:
        """The corners of the box around each organ as grown."""
        low, high = np.zeros((len(self.parent), 3)), np.zeros((len(self.parent), 3))
        used = np.flatnonzero(self._stop > self._first)
        if len(used):
            # Organs lie one after the other: the bounds of all in one pass.
            used = used[np.argsort(self._first[used])]
            vertices = self.mesh.vertices if self._order is None else self.mesh.vertices[self._order]
            low[used] = np.minimum.reduceat(vertices, self._first[used], axis=0)
            high[used] = np.maximum.reduceat(vertices, self._first[used], axis=0)
        return low, high
