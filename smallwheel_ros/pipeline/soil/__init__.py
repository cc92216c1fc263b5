# SPDX-License-Identifier: Apache-2.0
"""The law of the soil under the wheels: k, n and m with their covariance, and borders between soils."""
