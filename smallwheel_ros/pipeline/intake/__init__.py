# SPDX-License-Identifier: Apache-2.0
"""From messages to numbers: topics, decoding, plausibility, streams, and the watermark."""
