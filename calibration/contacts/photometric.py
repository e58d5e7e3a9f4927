# SPDX-License-Identifier: Apache-2.0
"""Contact circles from the colours themselves: all presses of one ball explained together.

Inside a contact the gel has the ball's slope, around it the slope falls off by a known law
(``slope_law``). One map from slope, sinking and place in the image to colour change has to explain
every press; the map is linear in its coefficients, so that only centre and radius of each press
and one blur are searched for, by Gauss-Newton, while the map is solved for anew in each round
(variable projection, G. H. Golub and V. Pereyra, SIAM J. Numer. Anal. 10, 1973). Nobody clicks,
and no lamp has to be known. Each press may have its own gain and offset of every channel: light
falls off over a gel in more ways than the map's terms of place.

Residuals are weighed after Huber, since shadows, dust and markers are no part of the model. They
are also alike among neighbours; standard deviations come from the sums over sectors of a press (the
sandwich estimate with clusters, K.-Y. Liang and S. L. Zeger, Biometrika 73, 1986).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.contacts.circle_arrays import circle_of
from taccel_lab.calibration.contacts.rings import RingSamples
from taccel_lab.calibration.contacts.slope_law import (
    MAX_CONTACT_RATIO,
    SINK_IN_SCALE,
    SlopeLaw,
    slope_law,
)
from taccel_lab.calibration.robust_spread import spread_about_zero

ITERATIONS = 14
STEP_PX = 0.2
"""Of the finite difference over the radius."""
GAIN_PRIOR = 0.15
"""Spread of the gain of a press's colour change around the map's."""
BLUR_PRIOR = 0.5
"""Spread of the logarithm of the blur around its guess."""
HUBER = 1.5
RIDGE = 1e-6
MAX_STEP = 0.08
"""Largest change of centre and radius in one round, in contact radii."""
CONVERGED_PX = 0.02
PRIOR_SAMPLES = 30.0
"""Independent samples that a press counts as against the priors."""


@dataclass(frozen=True)
class MapTerms:
    """Which terms the map from slope to colour has."""

    degree: int
    """Highest total power of the two slopes."""
    place_degree: int
    """Powers up to this one also depend on the place in the image, linearly."""
    drop_place: bool
    """The sinking's term depends on the place too."""

    @classmethod
    def for_presses(cls, count: int) -> MapTerms:
        """As many terms as so many presses can tell apart."""
        if count < 4:
            return cls(3, 0, False)
        return cls(4, 1, False) if count < 12 else cls(4, 2, True)

    def finer(self) -> MapTerms:
        """One power more of everything: how far circles move then says what the map leaves out."""
        return MapTerms(self.degree + 1, self.place_degree + 1, self.drop_place)

    def values(
        self, nx: np.ndarray, ny: np.ndarray, drop: np.ndarray, u: np.ndarray, v: np.ndarray
    ) -> np.ndarray:
        """Terms of the map, shape [n, term_count]; the arguments have shape [n]."""
        return self._columns(self._powers(nx), self._powers(ny), drop, u, v)

    def slopes(
        self,
        nx: np.ndarray,
        ny: np.ndarray,
        u: np.ndarray,
        v: np.ndarray,
        weights: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """How ``values @ weights`` changes with each of ``nx``, ``ny`` and ``drop``, shape [n, k]
        of ``weights`` [term_count, k]."""
        x, y, still = self._powers(nx), self._powers(ny), np.zeros_like(nx)
        along_x, along_y = (
            [still, *(k * power for k, power in enumerate(powers[:-1], start=1))]
            for powers in (x, y)
        )
        by_nx = self._columns(along_x, y, still, u, v)
        by_ny = self._columns(x, along_y, still, u, v)
        sunk = self._sunk(np.ones_like(nx), u, v)
        return by_nx @ weights, by_ny @ weights, np.stack(sunk).T @ weights[-len(sunk) :]

    def _powers(self, values: np.ndarray) -> list[np.ndarray]:
        powers = [np.ones_like(values)]
        for _ in range(self.degree):
            powers.append(powers[-1] * values)
        return powers

    def _columns(
        self,
        powers_x: Sequence[np.ndarray],
        powers_y: Sequence[np.ndarray],
        drop: np.ndarray,
        u: np.ndarray,
        v: np.ndarray,
    ) -> np.ndarray:
        columns = []
        for total in range(1, self.degree + 1):
            for i in range(total + 1):
                term = powers_x[i] * powers_y[total - i]
                columns.append(term)
                if total <= self.place_degree:
                    columns += [term * u, term * v]
        columns += self._sunk(drop, u, v)
        return np.stack(columns).T  # A fifth of the time of a copy with the terms side by side.

    def _sunk(self, drop: np.ndarray, u: np.ndarray, v: np.ndarray) -> list[np.ndarray]:
        return [drop, drop * u, drop * v] if self.drop_place else [drop]


@dataclass(frozen=True)
class FittedContact:
    """Circle of one press in pixels of the sampled picture."""

    circle: ContactCircle
    covariance: np.ndarray
    """Of u, v and radius [px^2], shape [3, 3]."""
    explained: float
    """Share of the colour change's energy that the map explains, at most 1."""
    rms_levels: float
    """Root mean square of what it leaves, a channel [levels]."""


@dataclass(frozen=True)
class _Leaning:
    """Slope and sinking at the samples of a press, shape [n] each."""

    law: SlopeLaw
    distance_px: np.ndarray
    along_u: np.ndarray
    """Unit vector away from the centre."""
    along_v: np.ndarray
    normal: np.ndarray
    drop: np.ndarray

    @property
    def nx(self) -> np.ndarray:
        return self.normal * self.along_u

    @property
    def ny(self) -> np.ndarray:
        return self.normal * self.along_v

    def rates(self, wider: SlopeLaw) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Rates of nx, ny and the sinking with u, v, radius and blur; ``wider`` is the law of a
        contact that is ``STEP_PX`` wider."""
        u, v = self.along_u, self.along_v
        away, by_radius, by_blur = self.law.rates(self.distance_px, wider, STEP_PX)
        around = self.normal / self.distance_px
        both = (around - away[0]) * u * v
        return [
            (-away[0] * u**2 - around * v**2, both, -away[1] * u),
            (both, -away[0] * v**2 - around * u**2, -away[1] * v),
            *((one[0] * u, one[0] * v, one[1]) for one in (by_radius, by_blur)),
        ]


@dataclass(frozen=True)
class _Seen:
    """What a round saw of a press before its step."""

    left: np.ndarray
    """What the map leaves [levels], shape [n, 3]."""
    jacobian: np.ndarray
    """Shape [n, 3, 10]."""
    weight: np.ndarray
    """Shape [n]."""
    normal: np.ndarray
    """Normal equations with their priors, shape [10, 10]."""


@dataclass
class _State:
    """Everything that is fitted of one press."""

    samples: RingSamples
    ball_px: float
    shape: np.ndarray
    """u, v, radius [px], shape [3]."""
    offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    gain: np.ndarray = field(default_factory=lambda: np.ones(3))
    robust: np.ndarray = field(default_factory=lambda: np.ones(1))
    rms: float = 0.0
    seen: _Seen | None = None
    """In the last round."""

    def contact(self) -> FittedContact:
        """The circle with what speaks for it."""
        assert self.seen is not None
        samples, weight = self.samples, self.seen.weight
        own = np.average(samples.change, axis=0, weights=weight**2)
        energy = _energy(samples.change - own, weight)
        pull = self.seen.left * (weight**2)[:, None]
        scores = np.einsum("ncp,nc->np", self.seen.jacobian[..., :9], pull)
        count = samples.sector_count
        sums = np.zeros((count, 9))
        np.add.at(sums, samples.sector, scores)
        bread = np.linalg.inv(self.seen.normal[:9, :9])
        covariance = (bread @ (sums.T @ sums) @ bread)[:3, :3] * (count / max(count - 3, 1))
        explained = 1.0 - _energy(self.seen.left, weight) / max(energy, 1e-9)
        return FittedContact(circle_of(self.shape), covariance, explained, self.rms)


def _energy(left: np.ndarray, weight: np.ndarray) -> float:
    return float(np.sum((left * weight[:, None]) ** 2))


@dataclass(frozen=True)
class PhotometricFit:
    """What ``fit_contacts`` found."""

    contacts: list[FittedContact]
    blur_px: float
    rms_levels: float
    """Root mean square residual over all presses, robustly weighed [levels]."""
    sums_by_press: np.ndarray
    """Weighted squared residual of each press [levels^2], shape [press_count]."""


def fit_contacts(
    samples: Sequence[RingSamples],
    circles: Sequence[ContactCircle],
    ball_px: Sequence[float],
    *,
    blur_px: float,
    terms: MapTerms | None = None,
    iterations: int = ITERATIONS,
    sink_in: float | None = None,
) -> PhotometricFit:
    """Refine the circles of presses of one sensor.

    ``samples`` are colour changes around the starting ``circles``; ``ball_px`` is the radius of
    each press's ball in pixels. ``blur_px`` is the guess of the picture's blur, ``sink_in`` another
    damping length of the slope's law than its own.
    """
    terms = terms or MapTerms.for_presses(len(samples))
    fit = _JointFit(
        samples, circles, ball_px, blur_px, terms, SINK_IN_SCALE if sink_in is None else sink_in
    )
    for done in range(1, iterations + 1):
        if fit.round(done) < CONVERGED_PX and done > 4:
            break
    return fit.result()


class _JointFit:
    def __init__(
        self,
        samples: Sequence[RingSamples],
        circles: Sequence[ContactCircle],
        ball_px: Sequence[float],
        blur_px: float,
        terms: MapTerms,
        sink_in: float,
    ) -> None:
        self.sink_in = sink_in
        self.blur_px = self.blur_guess = blur_px
        self.terms = terms
        self.presses = [
            _State(
                sample,
                ball,
                np.array([c.u_px, c.v_px, min(c.radius_px, 0.9 * ball)]),
                robust=np.ones(len(sample.change)),
            )
            for sample, c, ball in zip(samples, circles, ball_px, strict=True)
        ]
        self.map = np.zeros((1, 3))
        self.sums = np.zeros(len(self.presses))
        self.total = 0.0

    def _law(self, press: _State, wider_px: float = 0.0) -> SlopeLaw:
        reach_px = 1.5 * press.samples.reach_px
        radius_px = press.shape[2] + wider_px
        return slope_law(radius_px, press.ball_px, self.blur_px, reach_px, self.sink_in)

    def _leaning(self, press: _State) -> _Leaning:
        """Slopes and sinking at the samples of a press."""
        s, law = press.samples, self._law(press)
        du, dv = s.u_px - press.shape[0], s.v_px - press.shape[1]
        distance = np.hypot(du, dv) + 1e-9
        normal, drop = law.at(distance)
        return _Leaning(law, distance, du / distance, dv / distance, normal, drop)

    def design(self, press: _State, leaning: _Leaning) -> np.ndarray:
        """Terms of the map at the samples of a press."""
        s = press.samples
        return self.terms.values(leaning.nx, leaning.ny, leaning.drop, s.unit_u, s.unit_v)

    def round(self, number: int) -> float:
        """One round over map, presses and blur; the largest step of a circle [px]."""
        leanings = [self._leaning(press) for press in self.presses]
        designs = [self.design(*pair) for pair in zip(self.presses, leanings, strict=True)]
        self.map = self._solve_map(designs)
        pieces = []
        shared = np.zeros(2)
        self.total = 0.0
        for i, press in enumerate(self.presses):
            design, leaning = designs[i], leanings[i]
            model = design @ self.map
            left = press.samples.change - press.offset - press.gain * model
            self._weigh(press, left, number)
            weight = press.samples.weight * press.robust
            jacobian = self._jacobian(press, model, leaning)
            flat = (jacobian * weight[:, None, None]).reshape(-1, jacobian.shape[-1])
            residual = (left * weight[:, None]).ravel()
            normal, slope = flat.T @ flat, flat.T @ residual
            self.sums[i] = residual @ residual
            variance = self.sums[i] / max(len(residual), 1)
            prior = variance * PRIOR_SAMPLES / GAIN_PRIOR**2
            normal[range(6, 9), range(6, 9)] += prior
            slope[6:9] -= prior * (press.gain - 1)
            normal[range(9), range(9)] += 1e-9 * np.trace(normal)
            press.seen = _Seen(left, jacobian, weight, normal)
            inner, outer = normal[:9, :9], normal[:9, 9:]
            eliminated = np.linalg.solve(inner, np.column_stack([slope[:9], outer]))
            pieces.append(eliminated)
            shared += [
                float(normal[9, 9] - outer[:, 0] @ eliminated[:, 1]),
                float(slope[9] - outer[:, 0] @ eliminated[:, 0]),
            ]
            self.total += self.sums[i]
        blur_change = self._blur_change(shared, number)
        largest = 0.0
        for press, eliminated in zip(self.presses, pieces, strict=True):
            step = eliminated[:, 0] - eliminated[:, 1] * blur_change
            limit = MAX_STEP * press.shape[2]
            step[:3] = np.clip(step[:3], -limit, limit)
            press.shape = press.shape + step[:3]
            press.shape[2] = np.clip(
                press.shape[2], 0.05 * press.ball_px, MAX_CONTACT_RATIO * press.ball_px
            )
            press.offset = press.offset + step[3:6]
            press.gain = np.clip(press.gain + np.clip(step[6:9], -0.2, 0.2), 0.3, 3.0)
            largest = max(largest, float(np.abs(step[:3]).max()))
        self.blur_px += blur_change
        return largest

    def _solve_map(self, designs: list[np.ndarray]) -> np.ndarray:
        columns = []
        weights = [(press.samples.weight * press.robust) ** 2 for press in self.presses]
        scaled = [design * w[:, None] for design, w in zip(designs, weights, strict=True)]
        # The same for all colours but for a factor.
        squares = [one.T @ design for one, design in zip(scaled, designs, strict=True)]
        for c in range(3):
            normal, wanted = 0.0, 0.0
            for press, one, square in zip(self.presses, scaled, squares, strict=True):
                normal = normal + press.gain[c] ** 2 * square
                wanted = wanted + press.gain[c] * (
                    one.T @ (press.samples.change[:, c] - press.offset[c])
                )
            normal = np.asarray(normal)
            ridge = RIDGE * np.trace(normal) / len(normal) + 1e-12
            columns.append(np.linalg.solve(normal + ridge * np.eye(len(normal)), wanted))
        return np.stack(columns, axis=-1)

    def _weigh(self, press: _State, left: np.ndarray, number: int) -> None:
        distance = np.linalg.norm(left, axis=1)
        press.rms = float(np.sqrt(np.mean(distance**2) / 3))
        scale = spread_about_zero(distance) + 1e-6
        if number > 1:  # The first map has seen only starting circles.
            press.robust = np.sqrt(np.minimum(1.0, HUBER * scale / np.maximum(distance, 1e-9)))

    def _jacobian(self, press: _State, model: np.ndarray, leaning: _Leaning) -> np.ndarray:
        """Change of the modelled colours with u, v, radius, offsets, gains and blur."""
        s = press.samples
        by_leaning = self.terms.slopes(leaning.nx, leaning.ny, s.unit_u, s.unit_v, self.map)
        columns = [
            sum(a[:, None] * b for a, b in zip(moved, by_leaning, strict=True)) * press.gain
            for moved in leaning.rates(self._law(press, STEP_PX))
        ]
        each = np.eye(3)
        return np.concatenate(
            [
                np.stack(columns[:3], axis=-1),
                np.broadcast_to(each, (len(model), 3, 3)),
                model[:, :, None] * each,
                columns[3][:, :, None],
            ],
            axis=-1,
        )

    def _blur_change(self, shared: np.ndarray, number: int) -> float:
        if number < 3:
            return 0.0
        count = sum(press.samples.change.size for press in self.presses)
        prior = self.total / max(count, 1) * PRIOR_SAMPLES * len(self.presses)
        prior /= (BLUR_PRIOR * self.blur_guess) ** 2
        normal = shared[0] + prior
        slope = shared[1] - prior * (self.blur_px - self.blur_guess)
        limit = 0.3 * self.blur_px
        return float(np.clip(slope / max(normal, 1e-12), -limit, limit))

    def result(self) -> PhotometricFit:
        weights = sum(float(np.sum(press.robust**2)) for press in self.presses) * 3
        return PhotometricFit(
            contacts=[press.contact() for press in self.presses],
            blur_px=float(self.blur_px),
            rms_levels=float(np.sqrt(self.total / max(weights, 1.0))),
            sums_by_press=self.sums.copy(),
        )
