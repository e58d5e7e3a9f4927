# SPDX-License-Identifier: Apache-2.0
"""Files that come from elsewhere: one reader a format, with limits, whose errors are sentences."""
