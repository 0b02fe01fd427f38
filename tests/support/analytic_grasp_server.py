"""Test double of grasp_server: grasps for lone boxes, straight from the cloud, without a model.

It answers `synthesize_grasps` and `set_gripper` by the rules of the interface. `--fail-first N`
lets the first N answers per gripper point into the air; `--error CODE` answers every synthesis
with that error; `--width W` says how wide the boxes are (m).
"""

from __future__ import annotations

import argparse
import math
import sys
import threading

import numpy as np
import rclpy
from geometry_msgs.msg import Pose
from megrasp_msgs.msg import ErrorCode, Grasp, GraspArray
from megrasp_msgs.srv import ListGrippers, SetGripper, SynthesizeGrasps
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from scipy.spatial import cKDTree
from sensor_msgs.msg import PointCloud2

from megrasp_core.grippers import load_gripper
from megrasp_ros.conversions import matrix_from_pose, points_from_cloud, pose_from_matrix
from megrasp_ros.qos import SENSOR
from megrasp_ros.server.grasp_messages import gripper_info
from megrasp_ros.server.parameter_table import TABLE

APPROACH = 0.10
TOLERANCE = 0.008


class AnalyticGraspServer(Node):
    def __init__(self, fail_first: int, error: int, width: float) -> None:
        super().__init__("grasp_server")
        self._fail_first, self._error, self._width = fail_first, error, width
        self._gripper = None
        self._answers: dict[str, int] = {}
        self._cloud: PointCloud2 | None = None
        self._arrived = threading.Condition()
        for parameter, spec in TABLE.items():
            self.declare_parameter(parameter, spec.default)
        group = ReentrantCallbackGroup()
        self.create_service(ListGrippers, "list_grippers", self._list, callback_group=group)
        self.create_subscription(PointCloud2, "points", self._keep, SENSOR, callback_group=group)
        self.create_service(SetGripper, "set_gripper", self._set, callback_group=group)
        self.create_service(
            SynthesizeGrasps, "synthesize_grasps", self._synthesize, callback_group=group
        )

    def _keep(self, message: PointCloud2) -> None:
        with self._arrived:
            self._cloud = message
            self._arrived.notify_all()

    def _set(self, request, response):
        response.success = True
        if request.dry_run:
            return response
        self._gripper = load_gripper(request.gripper_name)
        self.get_logger().info(f"set_gripper {request.gripper_name}")
        return response

    def _list(self, request, response):
        assert self._gripper is not None
        response.grippers = [gripper_info(self._gripper, seen_in_training=False)]
        return response

    def _synthesize(self, request, response):
        if self._error:
            response.error_code, response.error_msg = self._error, "as ordered by the test"
            return response
        assert self._gripper is not None, "bin_clearing must call set_gripper first"
        name = self._gripper.name
        given = request.cloud.width > 0
        cloud = request.cloud if given else self._newer_than(request.not_before)
        response.grasps = GraspArray(header=cloud.header, gripper=name, model_id="analytic")
        count = self._answers[name] = self._answers.get(name, 0) + 1
        excluded = [matrix_from_pose(pose, "exclude")[:3, 3] for pose in request.exclude]
        self.get_logger().info(f"synthesize {name} excluded {len(excluded)} seed {request.seed}")
        tcps = _boxes_from_above(points_from_cloud(cloud), np.array([0.4, 0.3]) / 2)
        if count <= self._fail_first:
            tcps = [_raised(tcp, 0.06) for tcp in tcps]
        for tcp in tcps:
            far = (
                np.linalg.norm(tcp[:3, 3] - place) > request.exclude_radius for place in excluded
            )
            if all(far):
                response.grasps.grasps.append(self._grasp(tcp, len(response.grasps.grasps)))
        response.success = bool(response.grasps.grasps)
        if not response.success:
            response.error_code = ErrorCode.NO_GRASP_FOUND if tcps else ErrorCode.BIN_EMPTY
        return response

    def _newer_than(self, stamp) -> PointCloud2:
        after = (stamp.sec, stamp.nanosec)

        def newer() -> bool:
            cloud = self._cloud
            return (
                cloud is not None and (cloud.header.stamp.sec, cloud.header.stamp.nanosec) > after
            )

        with self._arrived:
            if not self._arrived.wait_for(newer, timeout=20.0):
                raise RuntimeError("no cloud arrived")
            assert self._cloud is not None
            return self._cloud

    def _grasp(self, tcp: np.ndarray, number: int) -> Grasp:
        pose = tcp @ np.linalg.inv(self._gripper.gripper_from_tcp)
        return Grasp(
            id=number,
            pregrasp=pose_from_matrix(pose),
            tcp=pose_from_matrix(tcp),
            approach=_lifted(pose),
            retreat=_lifted(pose),
            width=self._width,
            width_tolerance=TOLERANCE,
            score=0.5,
            collision_free=True,
        )


def _lifted(pose: np.ndarray) -> Pose:
    return pose_from_matrix(_raised(pose, APPROACH))


def _raised(pose: np.ndarray, by: float) -> np.ndarray:
    pose = pose.copy()
    pose[2, 3] += by
    return pose


def _boxes_from_above(points: np.ndarray, half: np.ndarray) -> list[np.ndarray]:
    """TCP poses (4, 4), highest cluster first, closing along the narrow side of its top."""
    inside = (np.abs(points[:, :2]) < half - 0.008).all(axis=1) & (points[:, 2] > 0.012)
    rest = points[inside][::4]
    poses = []
    while len(rest) > 60:
        top = rest[rest[:, 2].argmax()]
        tree = cKDTree(rest)
        members, frontier = set(), [int(rest[:, 2].argmax())]
        while frontier:
            found = set(np.concatenate(tree.query_ball_point(rest[frontier], 0.006)).tolist())
            frontier = list(found - members)
            members |= found
        chosen = np.zeros(len(rest), bool)
        chosen[list(members)] = True
        cluster = rest[chosen]
        rest = rest[~chosen]
        if len(cluster) < 60:
            continue
        upper = cluster[cluster[:, 2] > top[2] - 0.01]
        middle = (upper.min(axis=0) + upper.max(axis=0)) / 2
        _, axes = np.linalg.eigh(np.cov(upper[:, :2].T))
        x = np.array([*axes[:, 0], 0.0])
        pose = np.eye(4)
        pose[:3, 2] = [0, 0, -1]
        pose[:3, 0] = x
        pose[:3, 1] = np.cross(pose[:3, 2], x)
        pose[:3, 3] = [*middle[:2], max(0.022, top[2] - 0.018)]
        poses.append(pose)
    return poses


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--fail-first", type=int, default=0)
    parser.add_argument("--error", type=int, default=0)
    parser.add_argument("--width", type=float, default=math.nan)
    arguments = parser.parse_args(rclpy.utilities.remove_ros_args(sys.argv)[1:])
    rclpy.init()
    executor = MultiThreadedExecutor(num_threads=4)
    executor.add_node(AnalyticGraspServer(arguments.fail_first, arguments.error, arguments.width))
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
