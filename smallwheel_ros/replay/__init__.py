# SPDX-License-Identifier: Apache-2.0
"""Replay of a recorded drive through the node's estimator, without ROS."""
