# SPDX-License-Identifier: Apache-2.0
"""Cost of ground for a planner, from what wheels have found in it; without ROS."""
