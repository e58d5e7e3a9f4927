# SPDX-License-Identifier: Apache-2.0
"""Follow the dots of a resting gel through the frames of a motion.

Frame by frame: dots are detected at the size that they have at rest, matched to the markers by the
assignment that moves neighbours alike, and markers without a dot are looked for once more where
their neighbours say that they are. A marker that stays unseen goes along with its neighbours and is
found again when it reappears there, so that it keeps its identity through occlusion and through
motions of more than the pitch, as long as neighbours move alike from frame to frame. Frames that
are not what the camera saw are not read.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree

from taccel_lab.calibration.markers.tracks import MarkerTracks, TrackStatus
from taccel_lab.calibration.markers.whole_frames import (
    REPEATED_SHARE,
    SHORT,
    Fault,
    FrameJudge,
    Jump,
    Unread,
    common_jump,
    shift_words,
)
from taccel_lab.errors import InputError
from taccel_lab.guards import require_size
from taccel_lab.reading.dots import soft_ellipse as model
from taccel_lab.reading.dots.blobs import grey_levels
from taccel_lab.reading.dots.detection import DotFlag, Dots, detect_dots
from taccel_lab.reading.dots.dot_fit import fit_dots
from taccel_lab.reading.dots.lattice import lattice_index
from taccel_lab.reading.dots.lattice_growth import Neighbourhood
from taccel_lab.reading.dots.marker_picture import MarkerPicture

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
"""A dot that is looked for again lies within this number of pitches of its expected place."""
_WIDE, _NARROW = 0.55, 0.35
"""Gates in pitches: for a marker's own guess, and the narrowest for what its neighbours say."""
_GATE_SIGMAS = 3.0
"""Neighbours that scatter are believed within this multiple of their scatter, between these
gates."""
_ROUNDS = 6
_SUPPORT = 1.2
"""Weight of matched neighbours from which on they are believed."""
_ODD = 0.3
"""What an odd blob costs, in squared gates."""


def track_markers(frames: Iterable[np.ndarray], rest: MarkerPicture) -> MarkerTracks:
    """Follow the dots of ``rest`` through ``frames``.

    Args:
        frames: RGB or grey images in order, of the size of the picture at rest; the first has to
            be near rest (within half a pitch, or moved as a whole smoothly).
        rest: Dots at rest.

    Raises:
        InputError: Fewer than 4 dots at rest, no frame, or frames of another size.
    """
    tracker = MarkerTracker(rest)
    dots = tracker.dots
    states, unread, repeats = [], {}, []
    for number, frame in enumerate(frames):
        size = np.shape(frame)[1::-1]
        require_size(f"frame {number}", size, "the picture at rest", dots.size_px)
        tracker.advance(frame)
        states.append((tracker.uv, tracker.sigma, tracker.status))
        unread |= {number - k: one for k, one in tracker.found_out}
        if tracker.repeated and number not in unread:
            repeats.append(number)
    if not states:
        raise InputError("the video holds no frame")
    # Where most frames are alike to the bit, an encoder made them so.
    if len(repeats) <= REPEATED_SHARE * len(states):
        unread |= dict.fromkeys(repeats, Unread(Fault.REPEATED, ""))
    uv_px, sigma_px, status = map(np.array, zip(*states, strict=True))
    found = MarkerTracks(
        uv_px=uv_px,
        sigma_px=sigma_px,
        status=status,
        rest_px=dots.uv_px,
        rest_sigma_px=dots.sigma_px,
        row=tracker.row,
        column=tracker.column,
        size_px=dots.size_px,
    )
    return found.without(unread)


class MarkerTracker:
    """State of all markers in the present frame."""

    def __init__(self, rest: MarkerPicture) -> None:
        """All markers where they are at rest; InputError for fewer than 4."""
        dots, row, column = rest.dots, rest.lattice.row, rest.lattice.column
        if dots.count < MIN_MARKERS:
            raise InputError(
                f"tracking needs at least {MIN_MARKERS} dots at rest, got {dots.count}"
            )
        # Row by row, then those without a number from top to bottom.
        order = np.lexsort((np.where(row >= 0, column, dots.uv_px[:, 1]), row, row < 0))
        self.dots = self._found = dots = dots.select(order)
        self.row, self.column = row[order], column[order]
        self.around = Neighbourhood.of(dots.uv_px)
        self.scale = replace(dots.scale, threshold=_WEAKER * dots.scale.threshold)
        self.uv = dots.uv_px.copy()
        self.sigma = dots.sigma_px.copy()
        self.status = np.full(dots.count, TrackStatus.SEEN, dtype=np.uint8)
        self.motion = np.zeros_like(self.uv)
        self.unseen = np.zeros(dots.count, dtype=int)
        self.shape = dots.parameters.copy()
        self.unmatched = 0
        self.repeated = False
        """Whether the frame is the one before, to the bit."""
        self.found_out: list[tuple[int, Unread]] = []
        """Frames that turned out with this one not to be read: how many ago, 0 for this one."""
        self._judge, self._last = FrameJudge(rest), np.zeros(0)
        self._jump: Jump | None = None
        self._before: dict[str, np.ndarray] = {}
        self._since = 0

    def advance(self, frame: np.ndarray) -> None:
        """Match and place all markers in the next frame, where it can be read; predict them where
        it cannot."""
        self.repeated = np.array_equal(frame, self._last)
        if self.repeated:
            self.found_out = [(0, one) for k, one in self.found_out if k == 0]
            return
        self._last = frame
        unread = self._judge.fault(frame, self.motion)
        self.found_out = [] if unread is None else [(0, unread)]
        if unread is None:
            self.uv = self.uv + self._judge.carried_px
            self._found = detect_dots(frame, self.scale, self._found)
            self._read(frame, self._found)
        else:
            # A jump that may be none of the gel does not go on.
            self.motion = (_MEMORY if self._jump is None else 0.0) * self.motion
            self.uv = self.uv + self.motion
            self.status = np.minimum(self.status, TrackStatus.PREDICTED).astype(np.uint8)

    @property
    def unread(self) -> str:
        """Why the latest frame is not read, in words; empty where it is."""
        return " ".join(one.words for k, one in self.found_out if k == 0)

    def _read(self, frame: np.ndarray, found: Dots) -> None:
        """Place all markers by the dots of a frame; once more from where they were before a jump
        that turns out to be none of the gel."""
        names = "uv", "sigma", "status", "motion", "unseen", "shape"
        before = {name: getattr(self, name).copy() for name in names}
        self._place(frame, found)
        if self._jump is None:
            both = (self.status == TrackStatus.SEEN) & (before["status"] == TrackStatus.SEEN)
            pitch_px = self.around.pitch_px
            way = common_jump(self.uv - before["uv"], before["motion"], both, pitch_px)
            if way is not None:
                self._jump, self._before, self._since = Jump(before["uv"], way, pitch_px), before, 1
            return
        undone = self._jump.is_undone(before["uv"], found.uv_px)
        if undone:
            vars(self).update(self._before)
            self._place(frame, found)
            one = Unread(Fault.SHIFTED, shift_words(*self._jump.way_px.tolist()))
            self.found_out = [(k, one) for k in range(1, self._since + 1)]
        self._since += 1
        if undone is not None or self._since > SHORT:
            self._jump = None

    def _place(self, frame: np.ndarray, found: Dots) -> None:
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
        worse = _disagreement(chosen, self.uv, found.uv_px, self.around)
        if worse - self.unmatched < _DOUBT * self.dots.count:
            self.unmatched = int((chosen < 0).sum())
            return chosen
        whole = found.uv_px[~odd]
        places = _by_lattice(expected, self.row, self.column, whole, self.around.pitch_px)
        if places is not None:
            known = np.asarray(np.isfinite(places).all(axis=1))
            moved = np.where(known[:, None], places - self.uv, 0.0)
            said, _, _ = self.around.extrapolate(moved, known)
            guess = np.where(known[:, None], places, self.uv + said)
            guess = np.where(np.isfinite(guess), guess, expected)
            other = associate(guess, self.uv, found.uv_px, odd, self.around)
            if _disagreement(other, self.uv, found.uv_px, self.around) < worse:
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


def associate(
    expected: np.ndarray,
    before: np.ndarray,
    found: np.ndarray,
    odd: np.ndarray,
    around: Neighbourhood,
) -> np.ndarray:
    """Blob of each marker.

    Expected and found places are matched at least total squared distance, leaving markers and blobs
    over where nothing fits. Neighbours' matches then correct the expectations, and all is matched
    again, until nothing changes: a dot that jumped to the place of another one disagrees with the
    dots around it.

    Args:
        expected: Where each marker's own motion puts it, shape [marker, 2].
        before: Where it was, shape [marker, 2].
        found: Blobs of the frame, shape [blob, 2].
        odd: Blobs that are perhaps no dots, bool, shape [blob].
        around: Who is next to whom.

    Returns:
        Index into ``found``, -1 for none, int, shape [marker].
    """
    gate = np.full(len(expected), _WIDE * around.pitch_px)
    chosen = _assign(expected, found, odd, gate)
    for _ in range(_ROUNDS):
        matched = chosen >= 0
        if matched.sum() < 3:
            break
        moved = np.where(matched[:, None], found[chosen] - before, 0.0)
        said, scatter, support = around.extrapolate(moved, matched)
        trusted = (support >= _SUPPORT) & np.isfinite(said).all(axis=1)
        guess = np.where(trusted[:, None], before + said, expected)
        narrow, wide = _NARROW * around.pitch_px, _WIDE * around.pitch_px
        gate = np.where(trusted, np.clip(_GATE_SIGMAS * scatter, narrow, wide), wide)
        again = _assign(guess, found, odd, gate)
        if (again == chosen).all():
            break
        chosen = again
    return chosen


def _disagreement(
    chosen: np.ndarray, before: np.ndarray, found: np.ndarray, around: Neighbourhood
) -> float:
    """How badly an assignment moves neighbours alike, in markers: one for each marker without a
    blob, up to one for each that moves otherwise than its neighbours by half a pitch."""
    matched = chosen >= 0
    if matched.sum() < 3:
        return float(len(chosen))
    moved = np.where(matched[:, None], found[chosen] - before, 0.0)
    said, _, _ = around.extrapolate(moved, matched)
    miss = np.linalg.norm(moved - said, axis=1) / (0.5 * around.pitch_px)
    return float((~matched).sum() + np.minimum(np.nan_to_num(miss[matched], nan=1.0), 1.0).sum())


def _by_lattice(
    expected: np.ndarray,
    row: np.ndarray,
    column: np.ndarray,
    found: np.ndarray,
    pitch_px: float,
) -> np.ndarray | None:
    """Where the frame's own lattice puts the markers, however far they moved since the last frame.

    The blobs are numbered among themselves; blobs that lie where a marker is expected vote for how
    the two numberings are shifted. Neighbours that moved half a pitch more or less than each other
    break a matching by distance, but not a numbering.

    Args:
        expected: Where each marker's own motion puts it, shape [marker, 2].
        row: Row of each marker, -1 for none, shape [marker].
        column: Column of each marker, shape [marker].
        found: Blobs of the frame, shape [blob, 2].
        pitch_px: Distance of neighbours.

    Returns:
        Places, shape [marker, 2], NaN for markers without a blob; None where the blobs form no
        lattice or nobody votes.
    """
    lattice = lattice_index(found)
    if lattice.kind != "rectangular":
        return None
    numbered = np.flatnonzero(lattice.numbered)
    distance, nearest = map(np.asarray, KDTree(expected).query(found[numbered]))
    votes = (distance < 0.3 * pitch_px) & (row[nearest] >= 0)
    if not votes.any():
        return None
    shifts = np.stack(
        [
            row[nearest[votes]] - lattice.row[numbered[votes]],
            column[nearest[votes]] - lattice.column[numbered[votes]],
        ],
        axis=1,
    )
    names, counts = np.unique(shifts, axis=0, return_counts=True)
    shift = names[np.argmax(counts)]
    blob_at = {
        (int(lattice.row[n] + shift[0]), int(lattice.column[n] + shift[1])): n for n in numbered
    }
    places = np.full(expected.shape, np.nan)
    for marker, place in enumerate(zip(row.tolist(), column.tolist(), strict=True)):
        if place in blob_at and place[0] >= 0:
            places[marker] = found[blob_at[place]]
    return places


def _assign(
    expected: np.ndarray, found: np.ndarray, odd: np.ndarray, gate: np.ndarray
) -> np.ndarray:
    """Least-cost assignment; staying alone costs a gate's square."""
    chosen = np.full(len(expected), -1)
    if len(found) == 0:
        return chosen
    distance2 = ((expected[:, None] - found[None]) ** 2).sum(axis=2)
    cost = distance2 / gate[:, None] ** 2 + _ODD * odd[None]
    cost = np.where(np.isfinite(cost), np.minimum(cost, 1e3), 1e3)
    alone = np.full((len(expected), len(expected)), 1e3)
    np.fill_diagonal(alone, 1.0)
    rows, columns = linear_sum_assignment(np.concatenate([cost, alone], axis=1))
    real = (columns < len(found)) & (cost[rows, np.minimum(columns, len(found) - 1)] < 1.0)
    chosen[rows[real]] = columns[real]
    return chosen
