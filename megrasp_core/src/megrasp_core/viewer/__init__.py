"""Looking at clouds, grasps and grippers in a browser, with viser (extra `view`).

A viewer draws into a server, `open_server`, and answers to what is pressed in the page; it prints
nothing and starts no thread. `SceneViewer`: a cloud, ranked and rejected grasps, known and unknown
space, the region. `GripperViewer`: a gripper's frame, TCP, postures and pads.
"""

from .cloud_file import CloudFile
from .gripper_viewer import GripperViewer
from .scene_viewer import Outcome, SceneViewer
from .server import LOOPBACK, how_to_reach, open_server

__all__ = [
    "CloudFile",
    "GripperViewer",
    "LOOPBACK",
    "Outcome",
    "SceneViewer",
    "how_to_reach",
    "open_server",
]
