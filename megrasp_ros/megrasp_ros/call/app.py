"""Executable `megrasp_call`: arguments, exit codes, messages."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence

from megrasp_msgs.msg import ErrorCode
from rclpy.executors import ExternalShutdownException
from rclpy.utilities import remove_ros_args
from tyro.extras import SubcommandApp

from megrasp_core.errors import MegraspError
from megrasp_ros.calling import GraspServerError
from megrasp_ros.errors import NoCloudError

from .commands import change_tool, list_grippers, set_gripper, synthesize, watch
from .doctor import doctor
from .view import view

DESCRIPTION = """Ask a running grasp_server, from a machine with or without the `ros2` command.

Try: megrasp_call doctor
     megrasp_call synthesize -n 20 --out grasps.json
     megrasp_call view --follow

ROS_DOMAIN_ID and --namespace say which server. Exit codes: 0 done; 1 ran, but found nothing or
failed; 2 bad input."""

BAD_INPUT = {
    ErrorCode.INVALID_REQUEST,
    ErrorCode.UNKNOWN_GRIPPER,
    ErrorCode.BAD_DESCRIPTION,
}


def main() -> None:
    """Entry point of the executable."""
    sys.exit(run(remove_ros_args(sys.argv)[1:]))


def run(args: Sequence[str]) -> int:
    """Run the command line and return its exit code."""
    logging.basicConfig(level=logging.WARNING, format="megrasp_call: %(message)s")
    app = SubcommandApp()
    commands = {
        "synthesize": synthesize,
        "set_gripper": set_gripper,
        "change_tool": change_tool,
        "list": list_grippers,
        "watch": watch,
        "doctor": doctor,
        "view": view,
    }
    for name, command in commands.items():
        app.command(command, name=name)  # type: ignore[call-overload]
    try:
        return int(app.cli(prog="megrasp_call", description=DESCRIPTION, args=list(args)))
    except SystemExit as leave:
        # The parser has already said what is wrong, or has printed the help.
        return leave.code if isinstance(leave.code, int) else 2
    except GraspServerError as error:
        sys.stderr.write(f"megrasp_call: {error}\n")
        return 2 if error.code in BAD_INPUT else 1
    except (MegraspError, OSError) as error:
        sys.stderr.write(f"megrasp_call: {error}\n")
        return 1 if isinstance(error, NoCloudError) else 2
    except (KeyboardInterrupt, ExternalShutdownException):
        sys.stderr.write("megrasp_call: stopped\n")
        return 1
