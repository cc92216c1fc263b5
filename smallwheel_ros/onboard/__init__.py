# SPDX-License-Identifier: Apache-2.0
"""Parameters, settings and joints of a vehicle, without ROS: what node and replay share."""
