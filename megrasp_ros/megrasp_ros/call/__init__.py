"""The executable `megrasp_call`: the server from a shell, where there is no `ros2` command."""
