# SPDX-License-Identifier: Apache-2.0
"""Contact circles from the colours themselves: all presses of one ball explained together.

Inside a contact the gel has the ball's slope, around it the slope falls off by a known law
(``slope_law``). One map from slope, sinking and place in the image to colour change has to explain
every press. Centre and radius of each press, one blur and the map's coefficients step together by
Gauss-Newton: the map, which is linear, then never lags behind the circles, as where it is solved
for and eliminated (variable projection, G. H. Golub and V. Pereyra, SIAM J. Numer. Anal. 10, 1973;
L. Kaufman, BIT 15, 1975). Nobody clicks, and no lamp has to be known. Each press may have its own
gain and offset of every channel: light falls off over a gel in more ways than the map's terms of
place.

Residuals are weighed after Huber, since shadows, dust and markers are no part of the model. They
are also alike among neighbours; standard deviations come from the sums over sectors of a press (the
sandwich estimate with clusters, K.-Y. Liang and S. L. Zeger, Biometrika 73, 1986).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.circles.labels import circle_of
from taccel_lab.calibration.circles.press_model import (
    MAX_CONTACT_RATIO,
    PLAIN,
    SINK_IN_SCALE,
    MapTerms,
    slope_law,
)
from taccel_lab.robust_fit import spread_about_zero

RING_COUNT = 34
RAY_COUNT = 48
REACH_RADII = 1.4
"""Radius of the outermost ring, in contact radii: the gel beside a ball is modelled less well than
under it, and shadows lie there."""
SECTORS = 12
"""Sectors over the angle, each cut into an inner and an outer part."""
PASSES = 4
"""Solutions of one round, each with more steps at their limits."""
OWN = 9
"""Unknowns of a press: u, v and radius, an offset and a gain of each colour."""
START = (0.0, 0.0, 0.0, 1.0, 1.0, 1.0)
"""Offsets and gains that a fit begins with."""
GAIN_PRIOR = 0.15
"""Spread of the gain of a press's colour change around the map's."""
FIRST_GAIN_PRIOR = 1e-3
"""The same while circles may be far off: gains would make up for that."""
GAINS = (0.3, 3.0)
MAX_GAIN_STEP = 0.3
BLUR_PRIOR = 0.5
"""Spread of the logarithm of the blur around its guess."""
HUBER = 1.5
RIDGE = 1e-6
MAX_STEP = 0.08
"""Largest change of centre and radius in one round, in ball radii."""
HELD = 1e9
"""Weight of a step that is held at its limit, over what speaks for any of the press's steps."""
CONVERGED_PX = 0.02
PRIOR_SAMPLES = 30.0
"""Independent samples that a press counts as against the priors."""


@dataclass(frozen=True)
class RingSamples:
    """Colour changes of one press on rings around its contact: few samples, evenly spread over what
    matters. Those outside the image or on masked pixels are left out."""

    u_px: np.ndarray
    """Columns, shape [n]."""
    v_px: np.ndarray
    """Rows, shape [n]."""
    unit_u: np.ndarray
    """Columns as -1..1 over the image, shape [n]."""
    unit_v: np.ndarray
    change: np.ndarray
    """Colour change [levels], shape [n, 3]."""
    weight: np.ndarray
    """Root of the area that a sample stands for, relative to the mean, shape [n]."""
    sector: np.ndarray
    """Index of the sample's sector, shape [n]."""
    reach_px: float
    visible: float
    """Share of the samples that could be taken."""


def sample_rings(
    change: np.ndarray, circle: ContactCircle, mask: np.ndarray | None = None
) -> RingSamples:
    """Colour change [height_px, width_px, 3] at the rings around ``circle``, square pixels."""
    height, width = change.shape[:2]
    rings = (np.arange(RING_COUNT) + 0.5) / RING_COUNT
    angle = np.arange(RAY_COUNT) * (2 * np.pi / RAY_COUNT)
    distance = (rings * REACH_RADII * circle.radius_px)[:, None]
    u = (circle.u_px + distance * np.cos(angle)).ravel()
    v = (circle.v_px + distance * np.sin(angle)).ravel()
    taken = (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)
    if mask is not None:
        at = np.clip(np.rint(v), 0, height - 1).astype(int), np.clip(np.rint(u), 0, width - 1)
        taken &= mask[at[0], at[1].astype(int)]
    ring_weight = np.sqrt(rings / rings.mean())
    turn = np.arange(RAY_COUNT) * SECTORS // RAY_COUNT
    sector = 2 * turn[None, :] + (rings * REACH_RADII > 1.0)[:, None]
    u, v = u[taken], v[taken]
    values = np.zeros((0, 3))
    if len(u):
        columns, lines = u.astype(np.float32)[None], v.astype(np.float32)[None]
        values = cv2.remap(change, columns, lines, cv2.INTER_LINEAR)[0].astype(np.float64)
    return RingSamples(
        u_px=u,
        v_px=v,
        unit_u=2 * u / (width - 1) - 1,
        unit_v=2 * v / (height - 1) - 1,
        change=values.reshape(-1, 3),
        weight=np.repeat(ring_weight, RAY_COUNT)[taken],
        sector=sector.ravel()[taken],
        reach_px=float(REACH_RADII * circle.radius_px),
        visible=float(taken.mean()),
    )


@dataclass(frozen=True)
class FittedContact:
    """Circle of one press in pixels of the sampled picture."""

    circle: ContactCircle
    covariance: np.ndarray
    """Covariance of u, v and radius [px^2], shape [3, 3]."""
    explained: float
    """Share of the colour change's energy that the map explains, at most 1."""


@dataclass(frozen=True)
class _Seen:
    """What a round saw of a press before its step."""

    rows: np.ndarray
    """Rows, weighted: 1, the map's terms, rates of each colour with u, v, radius and blur, and what
    the map leaves of each colour, shape [row_count, n]."""
    jacobian: np.ndarray
    """Rates of each colour with offsets, gains, circle, blur and the map's coefficients in terms of
    ``rows``, shape [3, row_count, 10 + 3 term_count]; the press's own nine come first."""
    normal: np.ndarray
    """Normal equations with the priors of the press, shape [10 + 3 term_count, same]."""
    slope: np.ndarray
    """Their right side, shape [10 + 3 term_count]."""

    @property
    def left(self) -> np.ndarray:
        """What the map leaves of the colours, weighted [levels], shape [3, n]."""
        return self.rows[-3:]

    @property
    def own(self) -> np.ndarray:
        """Normal equations of the press's circle, offsets and gains, shape [9, 9]."""
        return self.normal[:OWN, :OWN]


@dataclass
class _State:
    """Everything that is fitted of one press."""

    samples: RingSamples
    ball_px: float
    own: np.ndarray
    """u, v and radius [px], an offset [levels] and a gain of each colour, shape [9]."""
    weight: np.ndarray
    """Weight of each sample, less where the map leaves too much, shape [n]."""
    step: np.ndarray = field(default_factory=lambda: np.zeros(OWN))
    """The last one, of circle, offsets and gains, shape [9]."""
    damping: float = 0.0
    """Damping of steps, after K. Levenberg and D. Marquardt."""
    seen: _Seen | None = None
    """What the last round saw; None before the first."""

    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest step of u, v, radius, offsets and gains, shape [9] each."""
        reach = np.repeat([MAX_STEP * self.ball_px, np.inf, MAX_GAIN_STEP], 3)
        low, high = np.full(OWN, -np.inf), np.full(OWN, np.inf)
        low[2], high[2] = 0.05 * self.ball_px, MAX_CONTACT_RATIO * self.ball_px
        low[6:], high[6:] = GAINS
        return np.maximum(low - self.own, -reach), np.minimum(high - self.own, reach)

    def contact(self) -> FittedContact:
        """The circle with what speaks for it."""
        assert self.seen is not None
        samples, seen = self.samples, self.seen
        change = samples.change - np.average(samples.change, axis=0, weights=self.weight**2)
        energy = np.sum((change * self.weight[:, None]) ** 2)
        count = 2 * SECTORS
        inside = (samples.sector == np.arange(count)[:, None]).astype(float)
        pulls = (inside * seen.left[:, None]) @ seen.rows.T @ seen.jacobian[..., :OWN]
        sums = pulls.sum(axis=0)
        bread = np.linalg.inv(seen.own)
        covariance = (bread @ (sums.T @ sums) @ bread)[:3, :3] * (count / max(count - 3, 1))
        explained = 1.0 - float(np.sum(seen.left**2) / max(energy, 1e-9))
        return FittedContact(circle_of(self.own[:3]), covariance, explained)


@dataclass(frozen=True)
class PhotometricFit:
    """What ``fit_contacts`` found."""

    contacts: list[FittedContact]
    blur_px: float
    rms_levels: float
    """Root mean square residual over all presses, robustly weighed [levels]."""
    sums_by_press: np.ndarray
    """Weighted squared residual of each press [levels^2], shape [press_count]."""
    terms: MapTerms
    map: np.ndarray
    """Its coefficients, shape [3, terms.count]."""
    gains: np.ndarray
    """Gain of each colour of each press, shape [press_count, 3]; so are the offsets [levels]."""
    offsets: np.ndarray


def fit_contacts(
    samples: Sequence[RingSamples],
    start: Sequence[ContactCircle] | PhotometricFit,
    ball_px: Sequence[float],
    iterations: int,
    *,
    blur_px: float | None = None,
    terms: MapTerms | None = None,
    settled: float = 1.0,
    sink_in: float = SINK_IN_SCALE,
) -> PhotometricFit:
    """Refine the circles of presses of one sensor.

    ``samples`` are colour changes around the circles of ``start``. A fit goes on with its map and
    blur, and with gains of the presses, which are 1 in the first. ``ball_px`` is the radius of each
    press's ball in pixels, ``blur_px`` the guess of the picture's blur (by default that of the
    fit), ``sink_in`` another damping length of the slope's law. The fit ends where the circles of
    the share ``settled`` of the presses rest.
    """
    fit = _JointFit(samples, start, ball_px, blur_px, terms, sink_in)
    for _ in range(iterations):
        if np.quantile(fit.round(), settled) < CONVERGED_PX:
            break
    return fit.result()


class _JointFit:
    def __init__(
        self,
        samples: Sequence[RingSamples],
        start: Sequence[ContactCircle] | PhotometricFit,
        ball_px: Sequence[float],
        blur_px: float | None,
        terms: MapTerms | None,
        sink_in: float,
    ) -> None:
        self.sink_in = sink_in
        before = None
        if isinstance(start, PhotometricFit):
            before, start = start, [contact.circle for contact in start.contacts]
        usual = MapTerms.for_presses(len(samples)) if before is None else before.terms
        self.terms = terms or usual
        self.presses = [
            _State(
                sample,
                ball,
                np.array([c.u_px, c.v_px, min(c.radius_px, 0.9 * ball), *START]),
                sample.weight,
            )
            for sample, c, ball in zip(samples, start, ball_px, strict=True)
        ]
        self.sums = np.zeros(len(self.presses))
        self.map = np.zeros((3, self.terms.count))
        self.gain_prior = FIRST_GAIN_PRIOR if before is None else GAIN_PRIOR
        if before is None:
            assert blur_px is not None
            self.blur_guess = self.blur_px = blur_px
            self.round()  # The map alone: no circle changes what it makes of nothing.
        else:
            self.blur_guess, self.blur_px = blur_px or before.blur_px, before.blur_px
            self.map = self.terms.taken_over(before.map, before.terms)
            for press, gain, offset in zip(self.presses, before.gains, before.offsets, strict=True):
                press.own[3:6], press.own[6:] = offset, gain

    def round(self) -> np.ndarray:
        """Steps presses, blur and map together; returns the largest change of u, v and radius of
        each circle [px], shape [press_count]."""
        for i, press in enumerate(self.presses):
            press.seen = self._see(press)
            self.sums[i] = np.sum(press.seen.left**2)
        change, steps = self._solve(
            *np.array([press.limits() for press in self.presses]).swapaxes(0, 1)
        )
        for press, step in zip(self.presses, steps, strict=True):
            # A step back says that the one before went too far: residuals bend what is fitted.
            back = step[:3] @ press.step[:3] < 0
            press.damping, press.step = 2 * press.damping + 0.5 if back else press.damping / 2, step
            press.own = press.own + step
        # What blurs adds up by squares: a picture changes with that of the blur evenly.
        square = self.blur_px**2 + 2 * self.blur_px * change[0]
        self.blur_px = float(np.sqrt(np.clip(square, self.blur_px**2 / 4, 16 * self.blur_px**2)))
        self.map = self.map + change[1:].reshape(self.map.shape)
        return np.abs(steps[:, :3]).max(axis=1)

    def _solve(self, lowest: np.ndarray, highest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Steps of blur and map, and of the presses, shape [press_count, 9], within limits.

        What would go beyond its limit is held there, and all else solved for once more: a map that
        counts on steps that nobody takes would be wrong for every press.
        """
        held = np.zeros(lowest.shape, dtype=bool)
        steps = np.zeros(lowest.shape)
        change = np.zeros(1)
        for _ in range(PASSES):
            solved, shared, wanted = [], 0.0, 0.0
            for press, hold, step in zip(self.presses, held, steps, strict=True):
                assert press.seen is not None
                seen, outer = press.seen, press.seen.normal[:OWN, OWN:]
                weight = hold * HELD * np.diag(seen.own).max()
                sides = np.column_stack([seen.slope[:OWN] + weight * step, outer])
                weight = weight + press.damping * np.diag(seen.own)
                solved.append(np.linalg.solve(seen.own + np.diag(weight), sides))
                shared = shared + seen.normal[OWN:, OWN:] - outer.T @ solved[-1][:, 1:]
                wanted = wanted + seen.slope[OWN:] - outer.T @ solved[-1][:, 0]
            change = self._shared_change(np.asarray(shared), np.asarray(wanted))
            free = np.array([own[:, 0] - own[:, 1:] @ change for own in solved])
            steps = np.clip(free, lowest, highest)
            beyond = (steps != free) & ~held
            held |= beyond
            if not beyond.any():
                break
        return change, steps

    def _see(self, press: _State) -> _Seen:
        """Residual, rates and normal equations of a press."""
        s = press.samples
        du, dv = s.u_px - press.own[0], s.v_px - press.own[1]
        distance = np.hypot(du, dv) + 1e-9
        along = np.stack([du, dv]) / distance
        (normal, drop), away, by_radius, by_blur = slope_law(
            distance, press.own[2], press.ball_px, self.blur_px, 1.5 * s.reach_px, self.sink_in
        )
        rows = self.terms.rows(*(normal * along), drop, s.unit_u, s.unit_v)
        model = self.map @ rows[PLAIN:]
        left = s.change.T - press.own[3:6, None] - press.own[6:, None] * model
        self._weigh(press, left)
        by_nx, by_ny, by_drop = (self.map @ self.terms.rates[:, PLAIN:]) @ rows
        outward = along[0] * by_nx + along[1] * by_ny
        around = (normal / distance) * (along[1] * by_nx - along[0] * by_ny)
        by_distance, *others = (
            one[0] * outward + one[1] * by_drop for one in (away, by_radius, by_blur)
        )
        moved = np.stack(
            [
                -along[0] * by_distance - along[1] * around,
                -along[1] * by_distance + along[0] * around,
                *others,
            ],
            axis=1,
        )
        rows = np.concatenate([rows[PLAIN - 1 :], moved.reshape(12, -1), left]) * press.weight
        gram = rows @ rows.T
        jacobian = self._jacobian(press)
        equations = jacobian.transpose(0, 2, 1) @ gram
        slope = np.sum([equations[c, :, c - 3] for c in range(3)], axis=0)
        equations = (equations @ jacobian).sum(axis=0)
        own = range(OWN)
        variance = float(np.trace(gram[-3:, -3:])) / max(3 * rows.shape[1], 1)
        prior = variance * PRIOR_SAMPLES / self.gain_prior**2
        equations[own[6:], own[6:]] += prior
        slope[6:OWN] -= prior * (press.own[6:] - 1)
        equations[own, own] += 1e-9 * np.trace(equations[:OWN, :OWN])
        return _Seen(rows, jacobian, equations, slope)

    def _weigh(self, press: _State, left: np.ndarray) -> None:
        distance = np.linalg.norm(left, axis=0)
        if self.map.any():
            reach = HUBER * (spread_about_zero(distance) + 1e-6)
            press.weight = press.samples.weight * np.sqrt(
                np.minimum(1.0, reach / np.maximum(distance, 1e-9))
            )

    def _jacobian(self, press: _State) -> np.ndarray:
        """``_Seen.jacobian``."""
        count = self.terms.count
        found = np.zeros((3, 1 + count + 12 + 3, OWN + 1 + 3 * count))
        terms = slice(1, 1 + count)
        for c, (rates, gain) in enumerate(zip(found, press.own[6:], strict=True)):
            moved = 1 + count + 4 * c + np.arange(4)
            rates[moved, [0, 1, 2, OWN]] = gain
            rates[0, 3 + c] = 1.0
            rates[terms, 6 + c] = self.map[c]
            first = OWN + 1 + c * count
            rates[terms, first : first + count] = gain * np.eye(count)
        return found

    def _shared_change(self, normal: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """Step of blur and map."""
        total = float(self.sums.sum())
        count = sum(press.samples.change.size for press in self.presses)
        prior = total / max(count, 1) * PRIOR_SAMPLES * len(self.presses)
        prior /= (BLUR_PRIOR * self.blur_guess) ** 2
        ridge = np.zeros(len(slope))
        ridge[0] = prior
        for c in range(3):
            mine = slice(1 + c * self.terms.count, 1 + (c + 1) * self.terms.count)
            ridge[mine] = RIDGE * np.trace(normal[mine, mine]) / self.terms.count + 1e-12
        now = np.concatenate([[self.blur_px - self.blur_guess], self.map.ravel()])
        return np.linalg.solve(normal + np.diag(ridge), slope - ridge * now)

    def result(self) -> PhotometricFit:
        weights = 3 * sum(
            float(np.sum((press.weight / press.samples.weight) ** 2)) for press in self.presses
        )
        return PhotometricFit(
            contacts=[press.contact() for press in self.presses],
            blur_px=float(self.blur_px),
            rms_levels=float(np.sqrt(self.sums.sum() / max(weights, 1.0))),
            sums_by_press=self.sums.copy(),
            terms=self.terms,
            map=self.map,
            gains=np.array([press.own[6:] for press in self.presses]),
            offsets=np.array([press.own[3:6] for press in self.presses]),
        )
