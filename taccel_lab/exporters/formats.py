# SPDX-License-Identifier: Apache-2.0
"""The formats that a profile can be exported to: names and one sentence each. Nothing heavy loads
here, so that help is fast."""

from __future__ import annotations

FORMATS = {
    "taccel": "Taccel's fabrication list: JSON, tets as VTK, masks and markers, STL.",
    "tacto": "TACTO's sensor configuration: YAML with camera, gel and lights, STL.",
    "taxim": "Calibration folder of the PyPI package taxim and of TacEx: colour table, background.",
    "isaac-lab": "Isaac Lab's GelSight data folder (TacSL) with its configuration.",
    "gs-sdk": "gs_sdk's device file, background and network from colour to gradients.",
    "onnx": "The networks of colour, normals and force as ONNX graphs.",
    "safetensors": "The same networks as safetensors, with settings and formula.",
    "opencv": "Camera matrix, distortion and pose as OpenCV's YAML.",
    "urdf": "A URDF with meshes, inertias and the frames of gel and camera.",
}
"""Name: what it is."""
