# SPDX-License-Identifier: Apache-2.0
"""The pixel-to-colour model: fit, cross-validation, held-out figures, Taxim's table beside it."""
