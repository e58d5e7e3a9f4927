# SPDX-License-Identifier: Apache-2.0
"""Where nodes are on a part of a step, and which of them are unknowns."""
