# SPDX-License-Identifier: Apache-2.0
"""A flat pad with two cameras."""
