"""ROS 2 bags, read by rosbags from the definitions of messages that they hold."""

from __future__ import annotations

import numpy as np
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

DTYPES = {"rgb8": (np.uint8, 3), "32FC1": (np.float32, 1), "16UC1": (np.uint16, 1)}
COLOUR, DEPTH = "/camera/color", "/camera/aligned_depth_to_color"
INSTANCE, DETECTIONS = "/camera/instance/image_raw", "/fruit/detections"


class Bag:
    """The messages of a bag by topic, each with its time in nanoseconds."""

    def __init__(self, folder):
        self.messages = {}
        with AnyReader([folder]) as reader:
            self.types = {connection.topic: connection.msgtype for connection in reader.connections}
            self.counts = {connection.topic: connection.msgcount for connection in reader.connections}
            for connection, time_ns, content in reader.messages():
                message = reader.deserialize(content, connection.msgtype)
                self.messages.setdefault(connection.topic, []).append((time_ns, message))

    def get(self, topic, number):
        return self.messages[topic][number][1]

    def times_s(self, topic=f"{COLOUR}/image_raw"):
        """Times at which messages were logged, which their headers state too."""
        for time_ns, message in self.messages[topic]:
            head = message.transforms[0].header if topic == "/tf" else message.header
            assert head.stamp.sec * 10**9 + head.stamp.nanosec == time_ns
        return [time_ns / 1e9 for time_ns, _ in self.messages[topic]]

    def image(self, topic, number):
        message = self.get(topic, number)
        dtype, channels = DTYPES[message.encoding]
        assert message.step == message.width * channels * np.dtype(dtype).itemsize
        pixels = np.frombuffer(message.data.tobytes(), np.dtype(dtype).newbyteorder("<"))
        return pixels.reshape(message.height, message.width, channels).squeeze()

    def transforms(self, number):
        """Poses `(4, 4)` of all frames in the world, by name."""
        message = self.get("/tf", number)
        assert {one.header.frame_id for one in message.transforms} == {"world"}
        return {
            one.child_frame_id: pose(one.transform.translation, one.transform.rotation)
            for one in message.transforms
        }


def xyz(vector):
    return np.array([vector.x, vector.y, vector.z])


def pose(position, orientation):
    """`(4, 4)` of a ROS position and quaternion."""
    matrix = np.eye(4)
    q = orientation
    matrix[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    matrix[:3, 3] = xyz(position)
    return matrix
