# SPDX-License-Identifier: Apache-2.0
"""The light of frames against each other, where they are untouched, and averages in one light."""
