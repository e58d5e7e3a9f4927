# SPDX-License-Identifier: Apache-2.0
"""Scale of the tactile image without a board: edges, markers, balls; and agreement."""
