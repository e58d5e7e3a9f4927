# SPDX-License-Identifier: Apache-2.0
"""Which remarks the dots and their tracks deserve."""

from __future__ import annotations

import numpy as np

from taccel_lab.calibration.dots.dots import DotFlag
from taccel_lab.calibration.dots.layout import LayoutFit
from taccel_lab.calibration.dots.marker_picture import MarkerPicture
from taccel_lab.calibration.markers import remarks
from taccel_lab.calibration.markers.track_figures import TrackFigures
from taccel_lab.report.remark import Remark

_FEW_DOTS = 16
_BENT = 0.05
"""RMS residual of the grid, in pitches, above which it is worth a remark."""
_WEAK_CONTRAST = 0.12
_SHAKY_PX = 0.1
_LOST = 0.2
_FAST = 0.4
"""Motion between frames, in pitches, from which on identities may swap."""
_ALIASES = 0.45
"""Motion between frames of most dots, in pitches, that a lattice cannot tell from one backwards."""
_NOT_BACK_PX = 1.0


def layout_remarks(picture: MarkerPicture, layout_mm: LayoutFit) -> list[Remark]:
    """Of the picture at rest."""
    dots, said = picture.dots, []
    numbered = int(picture.lattice.numbered.sum())
    if numbered < _FEW_DOTS:
        said.append(remarks.FEW_DOTS(count=numbered))
    beside = dots.count - numbered
    if beside > 0:
        said.append(remarks.DOTS_BESIDE_LATTICE(count=beside))
    for flag, kind in (
        (DotFlag.CUT, remarks.DOTS_CUT),
        (DotFlag.MERGED, remarks.DOTS_MERGED),
        (DotFlag.ODD, remarks.DOTS_ODD),
    ):
        count = int(dots.flagged(flag).sum())
        if count:
            said.append(kind(count=count, total=dots.count, grave=count / dots.count >= 0.2))
    if layout_mm.missing:
        said.append(remarks.DOTS_MISSING(count=len(layout_mm.missing)))
    contrast = float(np.median(np.abs(dots.contrast)))
    if contrast < _WEAK_CONTRAST:
        said.append(remarks.WEAK_CONTRAST(percent=100 * contrast))
    bent = layout_mm.residual_rms / min(layout_mm.pitch)
    if bent > _BENT:
        said.append(remarks.GRID_BENT(residual_mm=layout_mm.residual_rms, percent=100 * bent))
    return said


def track_remarks(figures: TrackFigures) -> list[Remark]:
    """Of one video."""
    name, said = figures.name, []
    if figures.jitter_px is not None and figures.jitter_px > _SHAKY_PX:
        said.append(remarks.JITTER(name=name, jitter_px=figures.jitter_px))
    if figures.jitter_px is None:
        said.append(remarks.NO_REST(name=name))
    if figures.common_step_in_pitches > _ALIASES:
        said.append(remarks.MOTION_ALIASES(name=name, pitches=figures.common_step_in_pitches))
    elif figures.step_in_pitches > _FAST:
        said.append(remarks.FAST_MOTION(name=name, pitches=figures.step_in_pitches))
    if figures.unseen_frames:
        shown = ", ".join(str(frame) for frame in figures.unseen_frames[:5])
        more = f" and {len(figures.unseen_frames) - 5} more" * (len(figures.unseen_frames) > 5)
        said.append(remarks.FRAMES_UNSEEN(name=name, unseen=shown + more))
    if figures.lost_share > _LOST:
        said.append(remarks.MARKERS_LOST(name=name, percent=100 * figures.lost_share))
    if figures.return_median_px is not None and figures.return_median_px > _NOT_BACK_PX:
        said.append(
            remarks.NOT_BACK(
                name=name, release=figures.return_frame, offset_px=figures.return_median_px
            )
        )
    return said
