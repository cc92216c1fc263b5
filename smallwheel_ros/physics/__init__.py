# SPDX-License-Identifier: Apache-2.0
"""What a wheel does in a soil: pure functions over arrays, free of files, plots and ROS."""
