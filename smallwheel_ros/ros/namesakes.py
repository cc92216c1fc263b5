# SPDX-License-Identifier: Apache-2.0
"""Other nodes of the same name: ROS lets them be, and nobody can tell them apart."""

from __future__ import annotations

from rclpy.node import Node


def namesakes(node: Node) -> str:
    """Say that there are other nodes of this one's name, and what to do; empty: there is none."""
    own = (node.get_name(), node.get_namespace())
    if node.get_node_names_and_namespaces().count(own) < 2:
        return ""
    return (
        f"another node is called {node.get_fully_qualified_name()} too: listeners get the answers of"
        " both, a service reaches either, and both save to one soil.file; end one, or give it another"
        " name (--ros-args -r __node:=NAME). One that was killed is taken for alive for 20 s"
    )
