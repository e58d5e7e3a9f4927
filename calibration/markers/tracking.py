# SPDX-License-Identifier: Apache-2.0
"""Follow the dots of a resting gel through the frames of a motion.

Frame by frame: dots are detected at the size that they have at rest, matched to the markers
(``association``), and markers without a dot are looked for once more where their neighbours say
that they are. A marker that stays unseen goes along with its neighbours and is found again when it
reappears there, so that it keeps its identity through occlusion and through motions of more than
the pitch, as long as neighbours move alike from frame to frame.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from taccel_lab.calibration.dots import soft_ellipse as model
from taccel_lab.calibration.dots.detection import detect_dots
from taccel_lab.calibration.dots.dot_fit import fit_dots
from taccel_lab.calibration.dots.dots import DotFlag, Dots
from taccel_lab.calibration.dots.grey_picture import grey_levels
from taccel_lab.calibration.dots.marker_picture import MarkerPicture
from taccel_lab.calibration.markers.association import associate, by_lattice, disagreement
from taccel_lab.calibration.markers.neighbourhood import Neighbourhood
from taccel_lab.calibration.markers.tracks import MarkerTracks, TrackStatus
from taccel_lab.errors import InputError

MIN_MARKERS = 4
LOST_AFTER = 12
"""Frames unseen after which a marker is lost rather than predicted."""
_MEMORY = 0.7
"""Share of the last motion between two frames that is expected to go on."""
_WEAKER = 0.6
"""Dots in contact may have this share of the contrast that separates dots at rest."""
_DOUBT = 0.03
"""Share of markers that newly disagree with their neighbours before the match is doubted."""
_GROWN = 1.25
"""Factor on a dot's radius between two frames that only a cover explains."""
_AGAIN = 0.3
"""A dot that is looked for again lies within so many pitches of its expected place."""


def track_markers(frames: Iterable[np.ndarray], rest: MarkerPicture) -> MarkerTracks:
    """Follow the dots of ``rest`` through ``frames``.

    Args:
        frames: RGB or grey images in order, of the size of the picture at rest; the first has to
            be near rest (within half a pitch, or moved as a whole smoothly).
        rest: Dots at rest.

    Raises:
        InputError: Fewer than 4 dots at rest, no frame, or frames of another size.
    """
    tracker = MarkerTracker.of(rest)
    dots, row, column = tracker.dots, tracker.row, tracker.column
    places, sigmas, statuses = [], [], []
    for number, frame in enumerate(frames):
        height, width = np.shape(frame)[:2]
        if (width, height) != dots.size_px:
            raise InputError(
                f"frame {number} is {width}x{height} px, the picture at rest "
                f"{dots.size_px[0]}x{dots.size_px[1]} px"
            )
        tracker.advance(frame)
        places.append(tracker.uv.copy())
        sigmas.append(tracker.sigma.copy())
        statuses.append(tracker.status.copy())
    if not places:
        raise InputError("the video holds no frame")
    return MarkerTracks(
        uv_px=np.array(places),
        sigma_px=np.array(sigmas),
        status=np.array(statuses),
        rest_px=dots.uv_px,
        rest_sigma_px=dots.sigma_px,
        row=row,
        column=column,
        size_px=dots.size_px,
    )


def _reading_order(rest: MarkerPicture) -> np.ndarray:
    """Row by row, then those without a number from top to bottom."""
    row, column, uv = rest.lattice.row, rest.lattice.column, rest.dots.uv_px
    return np.lexsort((np.where(row >= 0, column, uv[:, 1]), row, row < 0))


class MarkerTracker:
    """State of all markers in the present frame."""

    @classmethod
    def of(cls, rest: MarkerPicture) -> MarkerTracker:
        """All markers where they are at rest; InputError for fewer than 4."""
        count = rest.dots.count
        if count < MIN_MARKERS:
            raise InputError(f"tracking needs at least {MIN_MARKERS} dots at rest, got {count}")
        order = _reading_order(rest)
        return cls(rest.dots.select(order), rest.lattice.row[order], rest.lattice.column[order])

    def __init__(self, dots: Dots, row: np.ndarray, column: np.ndarray) -> None:
        self.dots = dots
        self.row, self.column = row, column
        self.around = Neighbourhood.of(dots.uv_px)
        self.scale = replace(dots.scale, threshold=_WEAKER * dots.scale.threshold)
        self.uv = dots.uv_px.copy()
        self.sigma = dots.sigma_px.copy()
        self.status = np.full(dots.count, TrackStatus.SEEN, dtype=np.uint8)
        self.motion = np.zeros_like(self.uv)
        self.unseen = np.zeros(dots.count, dtype=int)
        self.shape = dots.parameters.copy()
        self.unmatched = 0

    def advance(self, frame: np.ndarray) -> None:
        """Match and place all markers in the next frame."""
        found = detect_dots(frame, self.scale)
        before = self.uv
        expected = before + _MEMORY * self.motion
        chosen = self._match(expected, found)
        seen = chosen >= 0
        place = np.full_like(before, np.nan)
        sigma = np.full_like(before, np.nan)
        place[seen], sigma[seen] = found.uv_px[chosen[seen]], found.sigma_px[chosen[seen]]
        self._refit_hidden(frame, found, chosen, place, sigma)
        guess, scatter = self._say(place, seen, expected)
        self._look_again(frame, guess, place, sigma, seen)
        if (~seen).any():
            guess, scatter = self._say(place, seen, expected)
            place[~seen] = guess[~seen]
            sigma[~seen] = np.maximum(scatter[~seen], 0.05)[:, None]
        self.unseen = np.where(seen, 0, self.unseen + 1)
        self._set_status(place, seen)
        self.motion = place - before
        self.uv, self.sigma = place, sigma

    def _match(self, expected: np.ndarray, found: Dots) -> np.ndarray:
        """Blob of each marker: by motion, or by the frame's lattice where that agrees better."""
        odd = found.flagged(DotFlag.ODD)
        chosen = associate(expected, self.uv, found.uv_px, odd, self.around)
        worse = disagreement(chosen, self.uv, found.uv_px, self.around)
        if worse - self.unmatched < _DOUBT * self.dots.count:
            self.unmatched = int((chosen < 0).sum())
            return chosen
        whole = found.uv_px[~odd]
        places = by_lattice(expected, self.row, self.column, whole, self.around.pitch_px)
        if places is not None:
            known = np.asarray(np.isfinite(places).all(axis=1))
            moved = np.where(known[:, None], places - self.uv, 0.0)
            said, _, _ = self.around.extrapolate(moved, known)
            guess = np.where(known[:, None], places, self.uv + said)
            guess = np.where(np.isfinite(guess), guess, expected)
            other = associate(guess, self.uv, found.uv_px, odd, self.around)
            if disagreement(other, self.uv, found.uv_px, self.around) < worse:
                chosen = other
        self.unmatched = int((chosen < 0).sum())
        return chosen

    def _refit_hidden(
        self,
        frame: np.ndarray,
        found: Dots,
        chosen: np.ndarray,
        place: np.ndarray,
        sigma: np.ndarray,
    ) -> None:
        """Fit dots that seem to have shrunk or grown again with the size that they had: something
        covers a part of them. Changes place and sigma."""
        seen = np.flatnonzero(chosen >= 0)
        new = found.parameters[chosen[seen]]
        grown = np.log(model.mean_radius(new) / model.mean_radius(self.shape[seen]))
        strange = (np.abs(grown) > np.log(_GROWN)) & ~found.flagged(DotFlag.CUT)[chosen[seen]]
        self.shape[seen[~strange]] = new[~strange]
        if not strange.any():
            return
        markers = seen[strange]
        start = self.shape[markers].copy()
        start[:, :2] = place[markers]
        others = place[seen[~strange]]
        fit = fit_dots(grey_levels(frame), start, free_shape=False, others=others)
        good = fit.placed
        moved = np.abs(fit.uv_px - place[markers])
        place[markers[good]] = fit.uv_px[good]
        spread = fit.sigma_px[good]
        # What the two fits differ by is what the cover may have done to either.
        sigma[markers[good]] = np.hypot(spread, moved[good])

    def _say(
        self, place: np.ndarray, seen: np.ndarray, expected: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where the neighbours' displacements from rest put each marker."""
        rest = self.around.rest_px
        moved = np.where(seen[:, None], place - rest, 0.0)
        said, scatter, support = self.around.extrapolate(moved, seen)
        known = np.asarray(np.isfinite(said).all(axis=1))
        # The fewer neighbours are seen, the further the field has to be carried on.
        unseen = 1.0 - support / self.around.weight.sum(axis=1)
        scatter = scatter * (1.0 + 2.0 * unseen)
        return np.where(known[:, None], rest + said, expected), scatter

    def _look_again(
        self,
        frame: np.ndarray,
        guess: np.ndarray,
        place: np.ndarray,
        sigma: np.ndarray,
        seen: np.ndarray,
    ) -> None:
        """Fit a dot where an unseen marker should be; changes place, sigma and seen."""
        width, height = self.dots.size_px
        inside = ((guess > 0) & (guess < (width - 1, height - 1))).all(axis=1)
        wanted = np.flatnonzero(~seen & inside)
        if len(wanted) == 0:
            return
        start = self.shape[wanted].copy()
        start[:, :2] = guess[wanted]
        again = fit_dots(grey_levels(frame), start, others=place[seen])
        usual = self.dots.contrast[wanted]
        good = again.placed & (again.seen > 0.4)
        good &= again.contrast / usual > 0.35
        moved_px = np.hypot(*(again.uv_px - guess[wanted]).T)
        good &= moved_px < _AGAIN * self.around.pitch_px
        grown = np.log(again.radius_px / model.mean_radius(start))
        good &= np.abs(grown) < np.log(1.5)
        if seen.any():
            gap = np.hypot(*(again.uv_px[:, None] - place[seen][None]).transpose(2, 0, 1))
            good &= gap.min(axis=1) > again.radius_px
        place[wanted[good]] = again.uv_px[good]
        sigma[wanted[good]] = again.sigma_px[good]
        seen[wanted[good]] = True

    def _set_status(self, place: np.ndarray, seen: np.ndarray) -> None:
        width, height = self.dots.size_px
        slack = float(np.median(self.dots.radius_px))
        outside = ((place < -slack) | (place > (width - 1 + slack, height - 1 + slack))).any(axis=1)
        lost = ~seen & (outside | (self.unseen > LOST_AFTER))
        self.status = np.where(
            seen, TrackStatus.SEEN, np.where(lost, TrackStatus.LOST, TrackStatus.PREDICTED)
        ).astype(np.uint8)
