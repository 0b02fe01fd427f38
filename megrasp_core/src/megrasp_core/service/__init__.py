"""A resident planner for programs without ROS, over HTTP: one model, one gripper on at a time."""

from .client import PlannerClient, PlannerError
from .server import PlannerServer

__all__ = ["PlannerClient", "PlannerError", "PlannerServer"]
