"""The harvest truth rounds points that are just inside the image to points inside it."""

from __future__ import annotations

import numpy as np

from pepperscene.camera import Camera, load_lens, load_sensor
from pepperscene.classes import Instance, OrganClass
from pepperscene.truth.amodal import AmodalMask
from pepperscene.truth.harvest import FruitTruth, LabelView, harvest_truth


def test_rounding_leaves_points_in_the_picture():
    name = "realsense_d435_infrared"
    camera = Camera(load_lens(name), load_sensor(name).with_size(8, 6))
    matrix, nearly = camera.intrinsics, np.array([8 - 2e-4, 6 - 3e-4])
    point = np.append((nearly - matrix[:2, 2]) / matrix[[0, 1], [0, 1]], 1.0)
    pose = np.eye(4)
    pose[:3, 3] = point
    instance, size = Instance(OrganClass.PEPPER, "fruit"), np.ones(3) / 10
    measures = dict.fromkeys(("ripeness", "ripeness_spread", "length_m", "diameter_m"), 0.1)
    fruit = FruitTruth(0, instance, pose, -size, size, measures, point, (0,), None, None)
    view = LabelView(camera, np.ones((6, 8), np.uint16), np.ones((6, 8), np.float32))
    mask = AmodalMask((0, 0), np.ones((6, 8), bool))
    (entry,) = harvest_truth([(fruit, mask)], view, [instance])["fruit"]
    for name in ("stalk_end", "blossom_end"):
        x, y = entry[name]["px"]
        assert 7.999 <= x < 8
        assert 5.999 <= y < 6
