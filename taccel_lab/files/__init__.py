# SPDX-License-Identifier: Apache-2.0
"""Files in and out: one reader a format, with limits; whole or not at all; locks and the cache."""
