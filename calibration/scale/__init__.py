# SPDX-License-Identifier: Apache-2.0
"""Scale of the tactile image without a board: edges, markers, landmarks, balls; and agreement."""

from calibration.scale.combine import CombinedAxis, combine_axis
from calibration.scale.edge_line import EdgeLine, find_edge
from calibration.scale.edges import MeasuredEdge, scale_from_edges
from calibration.scale.estimate import ScaleEstimate
from calibration.scale.page import scale_page
from calibration.scale.scale_calibration import ScaleCalibration, calibrate_scale

__all__ = [
    "CombinedAxis",
    "EdgeLine",
    "MeasuredEdge",
    "ScaleCalibration",
    "ScaleEstimate",
    "calibrate_scale",
    "combine_axis",
    "find_edge",
    "scale_from_edges",
    "scale_page",
]
