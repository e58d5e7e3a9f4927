# SPDX-License-Identifier: Apache-2.0
"""The classic domed GelSight."""
