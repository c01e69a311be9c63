"""A ROS 2 node that answers depth images with poses: a sketch, not run as a test."""

import numpy as np
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.node import Node
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, Image

import pcnav


class Navigator(Node):
    """Subscribes to depth in metres (32FC1) or millimetres (16UC1), rectified."""

    def __init__(self) -> None:
        super().__init__("pcnav")
        self.target = pcnav.Target.from_mesh("satellite.stl", unit="mm")
        self.tracker: pcnav.Tracker | None = None
        self.out = self.create_publisher(PoseWithCovarianceStamped, "target_pose", 10)
        self.create_subscription(CameraInfo, "camera_info", self.on_camera, 1)
        self.create_subscription(Image, "depth", self.on_depth, 1)

    def on_camera(self, info: CameraInfo) -> None:
        if self.tracker is None:
            K = np.reshape(info.k, (3, 3))
            self.tracker = pcnav.Tracker(self.target, K, depth_unit="m")

    def on_depth(self, image: Image) -> None:
        if self.tracker is None:
            return
        is_mm = image.encoding == "16UC1"
        depth = np.frombuffer(image.data, np.uint16 if is_mm else np.float32)
        depth = depth.reshape(image.height, image.width) * np.float32(1e-3 if is_mm else 1.0)
        stamp = image.header.stamp
        try:
            est = self.tracker.step(depth, stamp.sec + 1e-9 * stamp.nanosec)
        except pcnav.InputError as error:  # a stamp that goes back, an image of another size
            self.get_logger().warning(str(error))
            return
        if not est.is_claimed or est.pose is None or est.pose_covariance is None:
            return
        answer = PoseWithCovarianceStamped(header=image.header)
        pose, place, q = answer.pose.pose, est.pose[:3, 3], Rotation.from_matrix(est.pose[:3, :3])
        pose.position.x, pose.position.y, pose.position.z = place
        turn = pose.orientation
        turn.x, turn.y, turn.z, turn.w = q.as_quat()
        # ROS 2 turns about the fixed axes of the camera, pcnav about those of the model.
        to_ros = np.kron(np.diag([1.0, 0.0]), np.eye(3))
        to_ros[3:, 3:] = est.pose[:3, :3]
        answer.pose.covariance = (to_ros @ est.pose_covariance @ to_ros.T).ravel()
        self.out.publish(answer)


rclpy.init()
rclpy.spin(Navigator())
