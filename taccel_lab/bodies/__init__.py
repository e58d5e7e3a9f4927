# SPDX-License-Identifier: Apache-2.0
"""What a scene is made of, on the host: bodies, materials, joints, shapes, motion in time."""
