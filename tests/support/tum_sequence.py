"""RGB-D sequences, read as TUM and ROS describe their files."""

from __future__ import annotations

import cv2
import numpy as np
import yaml
from scipy.spatial.transform import Rotation


class Sequence:
    """A folder: `info`, `times`, `files`, `depths` in metres, and `poses` `(n, 4, 4)` camera to world."""

    def __init__(self, folder):
        self.folder = folder
        self.info = yaml.safe_load((folder / "camera_info.yaml").read_text())
        pairs = table(folder / "associations.txt")
        self.times = [float(pair[0]) for pair in pairs]
        self.files = [(folder / pair[1], folder / pair[3]) for pair in pairs]
        self.depths = [
            cv2.imread(str(file), cv2.IMREAD_UNCHANGED).astype(float) / 1000 for _, file in self.files
        ]
        rows = np.array(table(folder / "groundtruth.txt"), float)
        assert rows[:, 0].tolist() == self.times
        self.poses = np.tile(np.eye(4), (len(rows), 1, 1))
        self.poses[:, :3, :3] = Rotation.from_quat(rows[:, 4:]).as_matrix()
        self.poses[:, :3, 3] = rows[:, 1:4]

    def matrix(self, key="camera_matrix"):
        block = self.info[key]
        return np.array(block["data"], float).reshape(block["rows"], block["cols"])


def table(path):
    lines = path.read_text().splitlines()
    return [line.split() for line in lines if not line.startswith("#")]
