"""Parameters that are read once, at the start of a node."""

from __future__ import annotations

from typing import Any, TypeVar, cast

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

T = TypeVar("T")


def declare_once(
    node: Node,
    name: str,
    default: T,
    description: str,
    *,
    low: float | None = None,
    high: float | None = None,
) -> T:
    """Declare a read-only parameter and return its value.

    Args:
        node: whose.
        name: of the parameter.
        default: its type is the parameter's.
        description: for `ros2 param describe`.
        low: least value of a number, and
        high: the greatest.

    Raises:
        ParameterException: the value that was given is of another type or outside the range.
    """
    limits: dict[str, Any] = {}
    if low is not None and high is not None:
        if isinstance(default, int):
            whole = IntegerRange(from_value=int(low), to_value=int(high), step=0)
            limits["integer_range"] = [whole]
        else:
            real = FloatingPointRange(from_value=float(low), to_value=float(high))
            limits["floating_point_range"] = [real]
    descriptor = ParameterDescriptor(description=description, read_only=True, **limits)
    return cast(T, node.declare_parameter(name, default, descriptor).value)
