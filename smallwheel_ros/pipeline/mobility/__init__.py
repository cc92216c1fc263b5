# SPDX-License-Identifier: Apache-2.0
"""What a wheel and the vehicle can do on the estimated soil."""
