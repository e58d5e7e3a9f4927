# SPDX-License-Identifier: Apache-2.0
"""Which remarks the dots and their tracks deserve."""

from __future__ import annotations

import numpy as np

from taccel_lab.calibration.dots.layout import LayoutFit
from taccel_lab.calibration.dots.marker_picture import MarkerPicture
from taccel_lab.calibration.markers import remarks
from taccel_lab.calibration.markers.track_figures import TrackFigures
from taccel_lab.report.remark import Remark

_BENT = 0.05
"""RMS residual of the grid, in pitches, above which it is worth a remark."""
_WEAK_CONTRAST = 0.12
_LOST = 0.2
_FAST = 0.4
"""Motion between frames, in pitches, from which on identities may swap."""
_ALIASES = 0.45
"""Motion between frames of most dots, in pitches, that a lattice cannot tell from one backwards."""


def layout_remarks(picture: MarkerPicture, layout_mm: LayoutFit) -> list[Remark]:
    """Of the picture at rest."""
    said = []
    contrast = float(np.median(np.abs(picture.dots.contrast)))
    if contrast < _WEAK_CONTRAST:
        said.append(remarks.WEAK_CONTRAST(percent=100 * contrast))
    bent = layout_mm.residual_rms / min(layout_mm.pitch)
    if bent > _BENT:
        said.append(remarks.GRID_BENT(residual_mm=layout_mm.residual_rms, percent=100 * bent))
    return said


def track_remarks(figures: TrackFigures) -> list[Remark]:
    """Of one video."""
    name, said = figures.name, []
    aliases = figures.common_step_in_pitches > _ALIASES
    if aliases or figures.step_in_pitches > _FAST:
        pitches = figures.common_step_in_pitches if aliases else figures.step_in_pitches
        said.append(remarks.FAST_MOTION(name=name, pitches=pitches, grave=aliases))
    if figures.lost_share > _LOST or figures.unseen_frames:
        said.append(remarks.MARKERS_LOST(name=name, percent=100 * figures.lost_share))
    return said
