# SPDX-License-Identifier: Apache-2.0
"""Scale of the tactile image without a board: edges, markers, landmarks, balls; and agreement."""

from taccel_lab.calibration.scale.combine import CombinedAxis, combine_axis
from taccel_lab.calibration.scale.edge_line import EdgeLine, find_edge
from taccel_lab.calibration.scale.edges import MeasuredEdge, scale_from_edges
from taccel_lab.calibration.scale.estimate import ScaleEstimate
from taccel_lab.calibration.scale.fit import ScaleCalibration, calibrate_scale
from taccel_lab.calibration.scale.report import scale_page

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
