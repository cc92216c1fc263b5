# SPDX-License-Identifier: Apache-2.0
"""Messages to numbers: topics, decoding, plausibility, streams, and up to when all is there."""
