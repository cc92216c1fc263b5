# SPDX-License-Identifier: Apache-2.0
"""Online estimate of the soil from what wheels measure: ROS-free, one for node and replay."""
