"""Results that clients wait for, and those that nobody has asked for."""

from __future__ import annotations

import threading

import rclpy
from cell_processes import in_executor, own_domain, result, spinning_node, until
from megrasp_msgs.action import GenerateGrasps
from rclpy.action import ActionClient
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node

from megrasp_ros.server.goal_server import GoalServer


def test_a_result_is_owed_until_it_is_there_and_sent_once_it_was_asked_for() -> None:
    domain, may_end = own_domain(6), threading.Event()

    def work(handle):
        may_end.wait(60.0)
        handle.succeed()
        return GenerateGrasps.Result()

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    node = Node("owner", context=context)
    server = GoalServer(node, GenerateGrasps, "work", work)
    executor = MultiThreadedExecutor(num_threads=2, context=context)
    executor.add_node(node)
    thread = threading.Thread(target=executor.spin, daemon=True)
    thread.start()
    try:
        with spinning_node(domain) as client_node:
            client = ActionClient(client_node, GenerateGrasps, "work")
            assert client.wait_for_server(60.0)
            assert server.owed() == [] and server.sent([])
            handle = result(
                in_executor(client_node, lambda: client.send_goal_async(GenerateGrasps.Goal()))
            )
            owed = server.owed()
            assert len(owed) == 1 and not server.sent(owed)
            may_end.set()
            assert until(lambda: not server.owed(), 60.0)
            assert not server.sent(owed)
            result(in_executor(client_node, handle.get_result_async))
            assert until(lambda: server.sent(owed), 60.0)
            in_executor(client_node, client.destroy)
    finally:
        executor.shutdown()
        thread.join(10.0)
        server.destroy()
        node.destroy_node()
        context.try_shutdown()
