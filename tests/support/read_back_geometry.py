"""Formats of cameras, depths and points read back as their specifications say, and compared with true points.

Cameras are converted to OpenCV's axes (right, down, forward), with the centre of the first pixel at (0, 0).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import trimesh
from bop_folder import annotations, corner_error, has_corners, load, scene_folder
from colmap_text import Model, rotation_of
from figures import LARGEST_PX, Figures
from rerun_recording import IMAGE, Recording
from traced_set import visible_pixels
from tum_sequence import Sequence

from pepperscene.truth.encodings import decode_rle


class View(NamedTuple):
    """What a file says about a frame.

    Attributes:
        index: of the frame.
        to_camera: `(4, 4)` world in metres to camera.
        matrix: `(3, 3)` of the pinhole camera.
        depth_mm: `(h, w)` along the optical axis, 0 for none; or None.
    """

    index: int
    to_camera: Any
    matrix: Any
    depth_mm: Any


def compare_view(figures, dataset, view):
    """Project 1000 exact points of visible surfaces by a view: they must be at their pixels and depths."""
    place = f"frame {view.index}"
    pixels, points = visible_pixels(dataset, view.index)
    in_camera = points @ view.to_camera[:3, :3].T + view.to_camera[:3, 3]
    assert (in_camera[:, 2] > 0).all(), f"{place}: a point is behind the camera"
    found = in_camera @ view.matrix.T
    figures.add_points(found[:, :2] / found[:, 2:], pixels, place)
    if view.depth_mm is not None:
        columns, rows = pixels.T
        figures.add_depths(view.depth_mm[rows, columns], 1000 * in_camera[:, 2], place)
        is_sky = np.isinf(dataset.image(view.index, "distance"))
        assert ((view.depth_mm == 0) == is_sky).all(), f"{place}: depth in the sky, or none on a surface"


def compare_views(dataset, views):
    figures, views = Figures(), list(views)
    assert sorted(view.index for view in views) == list(dataset.indices())
    for view in views:
        compare_view(figures, dataset, view)
    return figures


def read_depth(path):
    """A PNG of 16 bits in millimetres."""
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image.dtype == np.uint16
    return image.astype(float)


def scene_folders(folder, name):
    """The folders of scenes that have a file of this name; the export's own if there is one scene."""
    return [path.parent for path in sorted(folder.rglob(name))]


def check_photograph(dataset, index, path):
    assert path.read_bytes() == dataset.path(index, "colour").read_bytes(), (
        f"frame {index}: another photograph"
    )


def verify_nerfstudio(dataset, folder):
    """https://docs.nerf.studio/quickstart/data_conventions.html"""

    def views():
        for scene in scene_folders(folder, "transforms.json"):
            content = json.loads((scene / "transforms.json").read_text())
            for entry in content["frames"]:
                path = scene / entry["file_path"]
                check_photograph(dataset, int(path.stem), path)
                assert not any(entry[key] for key in ("k1", "k2", "p1", "p2") if key in entry)
                # Camera axes are right, up and backwards; the centre of the first pixel is at (0.5, 0.5).
                to_camera = np.diag([1, -1, -1, 1]) @ np.linalg.inv(entry["transform_matrix"])
                cx, cy = entry["cx"] - 0.5, entry["cy"] - 0.5
                matrix = np.array([[entry["fl_x"], 0, cx], [0, entry["fl_y"], cy], [0, 0, 1]])
                yield View(int(path.stem), to_camera, matrix, read_depth(scene / entry["depth_file_path"]))

    figures = compare_views(dataset, views())
    for scene in scene_folders(folder, "transforms.json"):
        content = json.loads((scene / "transforms.json").read_text())
        indices = [int(Path(entry["file_path"]).stem) for entry in content["frames"]]
        cloud = trimesh.load(scene / content["ply_file_path"])
        _compare_seed_points(figures, dataset, indices, cloud.vertices, f"seed points of {indices[0]}")
    return figures


def verify_colmap(dataset, folder):
    """https://colmap.github.io/format.html"""

    def views():
        for place in scene_folders(folder, "sparse"):
            model = Model(place)
            for pose, camera, name, observed in model.images.values():
                kind, _, _, (fx, fy, cx, cy) = model.cameras[camera]
                assert kind == "PINHOLE"
                check_photograph(dataset, int(name[:6]), place / "images" / name)
                to_camera = np.eye(4)
                to_camera[:3, :3], to_camera[:3, 3] = rotation_of(*pose[:4]), pose[4:]
                # The centre of the first pixel is at (0.5, 0.5).
                matrix = np.array([[fx, 0, cx - 0.5], [0, fy, cy - 0.5], [0, 0, 1]])
                points = np.array([model.points[int(number)][0] for number in observed[:, 2]])
                found = (points @ to_camera[:3, :3].T + to_camera[:3, 3]) @ matrix.T
                tracks.append((f"tracks of {name}", found[:, :2] / found[:, 2:], observed[:, :2] - 0.5))
                yield View(int(name[:6]), to_camera, matrix, None)

    tracks = []
    figures = compare_views(dataset, views())
    for place, found, expected in tracks:
        figures.add_points(found, expected, place)
    return figures


def _compare_seed_points(figures, dataset, indices, points, place):
    """Each point is that of a pixel of one of the frames."""
    from scipy.spatial import cKDTree

    surfaces = [dataset.image(index, "position").reshape(-1, 3) for index in indices]
    exact = np.concatenate([surface[np.isfinite(surface[:, 0])] for surface in surfaces])
    distance, _ = cKDTree(exact).query(points)
    figures.add_depths(1000 * distance, 0.0, place, 0.01)


def verify_rgbd(dataset, folder):
    """Formats: https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats, REP 104."""

    def views():
        for place in scene_folders(folder, "camera_info.yaml"):
            sequence = Sequence(place)
            assert not sequence.matrix("distortion_coefficients").any()
            for (colour, depth), pose in zip(sequence.files, sequence.poses, strict=True):
                check_photograph(dataset, int(colour.stem), colour)
                yield View(int(colour.stem), np.linalg.inv(pose), sequence.matrix(), read_depth(depth))

    return compare_views(dataset, views())


def verify_ply(dataset, folder):
    """Read by trimesh; points are in the order of the pixels that show a surface."""
    figures = Figures()
    for index in dataset.indices():
        place, camera = f"frame {index}", dataset.metadata(index)["camera"]
        cloud = trimesh.load(folder / "points" / f"{index:06d}.ply")
        vertices = cloud.metadata["_ply_raw"]["vertex"]["data"]
        is_surface = np.isfinite(dataset.image(index, "distance"))
        assert len(cloud.vertices) == is_surface.sum(), f"{place}: another number of points"
        x, y, z = ((cloud.vertices - np.array(camera["pose"])[:3, 3]) @ np.array(camera["pose"])[:3, :3]).T
        assert (z > 0).all(), f"{place}: a point is behind the camera"
        rows, columns = np.nonzero(is_surface)
        pixels = np.column_stack([camera["fx"] * x / z + camera["cx"], camera["fy"] * y / z + camera["cy"]])
        figures.add_points(pixels, np.column_stack([columns, rows]) + 0.5, place)
        figures.add_depths(1000 * z, 1000 * dataset.image(index, "depth_z")[is_surface], place)
        for name in ("class", "instance"):
            image = np.zeros(is_surface.shape, int)
            image[is_surface] = np.ravel(vertices[name])
            figures.add_labels(image, dataset.image(index, name), f"{place}, {name}")
        colours = dataset.image(index, "colour")[is_surface]
        assert (cloud.colors[:, :3] == colours).all(), f"{place}: other colours"
    return figures


def verify_bop(dataset, folder):
    """https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md"""

    def views():
        for index in dataset.indices():
            scene = scene_folder(dataset, folder, index)
            check_photograph(dataset, index, scene / "rgb" / f"{index:06d}.png")
            camera = load(scene / "scene_camera.json")[str(index)]
            to_camera = np.eye(4)
            to_camera[:3, :3] = np.reshape(camera["cam_R_w2c"], (3, 3))
            to_camera[:3, 3] = np.array(camera["cam_t_w2c"]) / 1000
            depth = camera["depth_scale"] * read_depth(scene / "depth" / f"{index:06d}.png")
            yield View(index, to_camera, np.reshape(camera["cam_K"], (3, 3)), depth)

    figures = compare_views(dataset, views())
    info = load(folder / "models" / "models_info.json")
    for index, entry, number, *camera in annotations(dataset, folder):
        if has_corners(entry):
            size = np.array([info[str(number)][f"size_{axis}"] for axis in "xyz"])
            error = corner_error(entry, size, *camera)
            assert error <= LARGEST_PX, f"frame {index}, object {number}: a corner of its box is elsewhere"
            figures.points += 8
            figures.largest_px = max(figures.largest_px, error)
    for index in dataset.indices():
        _compare_masks(figures, dataset, index, scene_folder(dataset, folder, index))
    return figures


def _compare_masks(figures, dataset, index, scene):
    instance = dataset.image(index, "instance")
    for number, entry in enumerate(dataset.image(index, "harvest")["fruit"]):
        place, file = f"frame {index}, fruit {number}", f"{index:06d}_{number:06d}.png"
        expected = {"mask": decode_rle(entry["amodal"]), "mask_visib": instance == entry["instance"]}
        for name, mask in expected.items():
            found = cv2.imread(str(scene / name / file), cv2.IMREAD_UNCHANGED)
            figures.add_mask(found > 0, mask, f"{place}, {name}")


def verify_rerun(dataset, folder):
    recordings = {path: Recording(path) for path in sorted(folder.rglob("*.rrd"))}
    return compare_recordings(dataset, recordings.values())


def compare_recordings(dataset, recordings):
    """Cameras, depths, classes and boxes of `recordings`, without distortion of the lens."""
    views = []
    for recording in recordings:
        for frame in recording.frames:
            matrix, pose = recording.camera(frame)
            matrix[:2, 2] -= 0.5  # the centre of the first pixel is at (0.5, 0.5)
            views.append(
                View(frame, np.linalg.inv(pose), matrix, recording.image("depth", frame).astype(float))
            )
    figures = compare_views(dataset, views)
    for recording in recordings:
        for frame in recording.frames:
            place = f"frame {frame}"
            figures.add_labels(recording.image("classes", frame), dataset.image(frame, "class"), place)
            photograph = recording.colour(frame)
            assert (photograph == dataset.image(frame, "colour")).all(), f"{place}: another photograph"
            _compare_boxes(figures, dataset, frame, recording)
    return figures


def _compare_boxes(figures, dataset, frame, recording):
    """Boxes are in the order of their labels, "kind instance"."""
    columns = {
        name: recording.get(f"{IMAGE}/boxes", f"Boxes2D:{name}", frame)
        for name in ("centers", "half_sizes", "class_ids", "labels")
    }
    instance, entries = dataset.image(frame, "instance"), dataset.metadata(frame)["instances"]
    for centre, half, organ_class, label in zip(*columns.values(), strict=True):
        value = label.split()[-1]
        place = f"frame {frame}, organ {value}"
        rows, cols = np.nonzero(instance == int(value))
        expected = [[cols.min(), rows.min()], [cols.max() + 1, rows.max() + 1]]
        corners = np.array([np.subtract(centre, half), np.add(centre, half)])
        figures.add_points(corners, np.array(expected), f"{place}, box")
        assert organ_class == entries[value]["class"], f"{place}: the class differs"
