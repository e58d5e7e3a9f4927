# SPDX-License-Identifier: Apache-2.0
"""What a user has to know about the dots and their tracks."""

from __future__ import annotations

import numpy as np

from taccel_lab.calibration.dots.dots import DotFlag
from taccel_lab.calibration.dots.layout import LayoutFit
from taccel_lab.calibration.dots.marker_picture import MarkerPicture
from taccel_lab.calibration.markers.track_figures import TrackFigures
from taccel_lab.calibration.result import Remark, Severity

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
    dots, remarks = picture.dots, []
    numbered = int(picture.lattice.numbered.sum())
    if numbered < _FEW_DOTS:
        remarks.append(
            Remark(
                Severity.WARNING,
                "few_dots",
                f"only {numbered} dots were numbered; pitch and rotation rest on few points",
            )
        )
    beside = dots.count - numbered
    if beside > 0:
        remarks.append(
            Remark(
                Severity.INFO,
                "dots_beside_lattice",
                f"{beside} blobs look like dots but have no place in the grid; they are left out",
            )
        )
    for flag, code, what in (
        (DotFlag.CUT, "dots_cut", "are cut by the border of the picture"),
        (DotFlag.MERGED, "dots_merged", "touch another dot and were split from it"),
        (DotFlag.ODD, "dots_odd", "differ much from the others in size, shape or contrast"),
    ):
        count = int(dots.flagged(flag).sum())
        if count:
            share = count / dots.count
            severity = Severity.INFO if flag is DotFlag.CUT or share < 0.2 else Severity.WARNING
            remarks.append(Remark(severity, code, f"{count} of {dots.count} dots {what}"))
    if layout_mm.missing:
        remarks.append(
            Remark(
                Severity.INFO,
                "dots_missing",
                f"{len(layout_mm.missing)} places of the grid in view hold no dot",
            )
        )
    contrast = float(np.median(np.abs(dots.contrast)))
    if contrast < _WEAK_CONTRAST:
        remarks.append(
            Remark(
                Severity.WARNING,
                "weak_contrast",
                f"the dots take {100 * contrast:.0f} % of the light; more light or sharper focus "
                "would place them better",
            )
        )
    bent = layout_mm.residual_rms / min(layout_mm.pitch)
    if bent > _BENT:
        remarks.append(
            Remark(
                Severity.WARNING,
                "grid_bent",
                f"dots lie {layout_mm.residual_rms:.3f} mm ({100 * bent:.0f} % of the pitch) off a "
                "regular grid: lens distortion (calibrate the camera first), a stretched gel, or "
                "dots painted by hand",
            )
        )
    return remarks


def track_remarks(figures: TrackFigures) -> list[Remark]:
    """Of one video."""
    name, remarks = figures.name, []
    if figures.jitter_px is not None and figures.jitter_px > _SHAKY_PX:
        remarks.append(
            Remark(
                Severity.WARNING,
                "jitter",
                f"{name}: dots at rest scatter by {figures.jitter_px:.2f} px between frames; "
                "steadier light, less compression or more exposure would help",
            )
        )
    if figures.jitter_px is None:
        remarks.append(
            Remark(
                Severity.INFO,
                "no_rest",
                f"{name}: fewer than 5 frames at rest at its start, so that the jitter is unknown",
            )
        )
    if figures.common_step_in_pitches > _ALIASES:
        remarks.append(
            Remark(
                Severity.ERROR,
                "motion_aliases",
                f"{name}: most dots move by {figures.common_step_in_pitches:.2f} pitches between "
                "two frames: a lattice that moves by more than half a pitch looks as if it moved "
                "back, so that displacements may be wrong by whole pitches. Record slower motion "
                "or more frames a second",
            )
        )
    elif figures.step_in_pitches > _FAST:
        remarks.append(
            Remark(
                Severity.WARNING,
                "fast_motion",
                f"{name}: dots move up to {figures.step_in_pitches:.2f} pitches between two "
                "frames; beyond 0.4 they may be taken for their neighbours: record slower motion "
                "or more frames a second",
            )
        )
    if figures.unseen_frames:
        shown = ", ".join(str(frame) for frame in figures.unseen_frames[:5])
        more = f" and {len(figures.unseen_frames) - 5} more" * (len(figures.unseen_frames) > 5)
        remarks.append(
            Remark(
                Severity.WARNING,
                "frames_unseen",
                f"{name}: fewer than half of the dots are seen in frame {shown}{more} (counted "
                "from 0): dark, blurred or covered; places there are predictions",
            )
        )
    if figures.lost_share > _LOST:
        remarks.append(
            Remark(
                Severity.WARNING,
                "markers_lost",
                f"{name}: {100 * figures.lost_share:.0f} % of markers and frames are lost",
            )
        )
    if figures.return_median_px is not None and figures.return_median_px > _NOT_BACK_PX:
        remarks.append(
            Remark(
                Severity.INFO,
                "not_back",
                f"{name}: after release (frame {figures.return_frame}) the dots are "
                f"{figures.return_median_px:.2f} px from rest at the median: the gel creeps, "
                "slipped, or was not let go",
            )
        )
    return remarks
