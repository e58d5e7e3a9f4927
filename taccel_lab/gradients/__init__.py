# SPDX-License-Identifier: Apache-2.0
"""Gradients of quasi-static motions with respect to materials, friction, sizes and tool paths.

``GelMotion`` runs, ``pull_back`` gives the gradients of a loss; both as one function of torch are
``torch_motion.TorchMotion``.
"""

from taccel_lab.gradients.adjoint import Gradients, pull_back
from taccel_lab.gradients.motion import TIGHT, GelMotion, MotionRecord

__all__ = ["TIGHT", "GelMotion", "Gradients", "MotionRecord", "pull_back"]
