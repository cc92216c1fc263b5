# SPDX-License-Identifier: Apache-2.0
"""Everything between topics and estimates, without ROS: what node and replay share."""
