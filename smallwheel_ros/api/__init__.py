# SPDX-License-Identifier: Apache-2.0
"""The functions of `import smallwheel_ros`, one file each."""
