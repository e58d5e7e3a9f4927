# SPDX-License-Identifier: Apache-2.0
"""Slopes of what comes of quasi-static motions over materials, friction, sizes and tools' ways.

``GelMotion`` runs, ``pull_back`` gives the gradients of a loss; both as one function of torch are
``torch_motion.TorchMotion``.
"""

from taccel_lab.gradients.adjoint import Gradients, pull_back
from taccel_lab.gradients.motion import TIGHT, GelMotion, MotionRecord

__all__ = ["TIGHT", "GelMotion", "Gradients", "MotionRecord", "pull_back"]
