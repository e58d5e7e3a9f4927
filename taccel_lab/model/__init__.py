# SPDX-License-Identifier: Apache-2.0
"""Static device arrays of a scene; ``build_model`` makes them."""

from taccel_lab.model.build import build_model
from taccel_lab.model.model import AffineArrays, BodyKind, BodyRange, Model, RigidTarget

__all__ = ["AffineArrays", "BodyKind", "BodyRange", "Model", "RigidTarget", "build_model"]
