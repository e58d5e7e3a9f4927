# SPDX-License-Identifier: Apache-2.0
"""Where the nodes of a dome's mesh lie on its cap: evenly, or graded around a contact.

Stereographic projection maps the cap conformally onto the unit disc, and the Moebius maps of the
disc onto itself become conformal maps of the cap onto itself: a grid around the apex turns into a
grid around any contact which still ends on the cap's edge and keeps all its angles.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from taccel_lab.cad.mesh.conformal import disc_automorphism
from taccel_lab.cad.mesh.contact_plan import ContactOutline, contact_plan
from taccel_lab.cad.mesh.focus import FocusOptions, graded_rings
from taccel_lab.cad.mesh.grid import bulged_core, core_perimeter, spoke_angles
from taccel_lab.cad.parts.dome_pad import DomePad

LARGEST_CORE = 0.52
"""Half width of the core over the ring around it at most: its corners reach 1.28 times as far."""
_LARGEST_HALF = 0.3
"""Half width of a focus's core in the disc at most."""
_CORE_CLEARANCE = 0.9
_TURN_FROM, _EDGE_DECAY = 0.4, 2
"""Radius and power with which that turn sets in: what lies around the focus keeps its shape."""
_EDGE_SHARE = 0.75
"""How far ring nodes on the cap's edge turn from where the Moebius map puts them to even ones."""
_RIGID_TO = (0.1, 0.4)
"""Radii up to which a grid is rotated onto its focus, and from which the Moebius map moves it."""
_DEEP_SHARE = 0.2
"""How far the grid deep under a focus follows it: columns that lean less have better tets."""


@dataclass(frozen=True)
class DomeCounts:
    """Cells of a dome's mesh; equal counts give equal connectivity and regions."""

    core: int
    """Cells along each side of the core around the apex."""
    window_rings: int
    """Rings between the core and the window's edge; 0 when the cap has no such edge."""
    cap_rings: int
    """All rings between the core and the cap's edge."""
    free_rings: int
    """Rings on the free part of the wall under the cap."""
    bonded_rings: int
    """Rings on the glued part of the wall."""
    layers: int
    halved_layers: int = 0
    """Lowest of these, in which the plan is halved."""

    @property
    def rings(self) -> int:
        return self.cap_rings + self.free_rings + self.bonded_rings


def disc_from_angle(theta: np.ndarray, cap_angle: float) -> np.ndarray:
    """Radius in the disc of a polar angle on the cap [rad]; 1 at the cap's edge."""
    return np.tan(0.5 * np.asarray(theta)) / np.tan(0.5 * cap_angle)


def angle_from_disc(radius: np.ndarray, cap_angle: float) -> np.ndarray:
    """Polar angle on the cap [rad] of a radius in the disc."""
    return 2 * np.arctan(np.asarray(radius) * np.tan(0.5 * cap_angle))


def core_share(core: int, rings: int) -> float:
    """Half width of the core over the polar angle that ``rings`` rings reach, for even cells."""
    return min(0.5 * core / (0.5 * core + _CORE_CLEARANCE * rings), LARGEST_CORE)


@lru_cache(maxsize=32)
def even_cap(counts: DomeCounts, cap_angle: float, window_angle: float | None) -> np.ndarray:
    """Disc points of about even spacing on the cap, complex, shape [nodes of the grid].

    With ``window_angle`` the ring ``counts.window_rings`` lies exactly on that polar angle [rad].
    """
    spokes = np.exp(1j * spoke_angles(counts.core))
    first, last = counts.window_rings, counts.cap_rings - counts.window_rings
    half = core_share(counts.core, first or last) * (window_angle or cap_angle) / cap_angle
    square = half * (bulged_core(counts.core) @ np.array([1, 1j])).ravel()
    edge = square[core_perimeter(counts.core)]
    loops = []
    if window_angle is not None:
        border = window_angle / cap_angle * spokes
        loops += [edge + (border - edge) * k / first for k in range(1, first + 1)]
        edge = border
    loops += [edge + (spokes - edge) * k / last for k in range(1, last + 1)]
    # Up to here the radius is the share of the polar angle.
    q = np.concatenate([square, *loops])
    radius = np.maximum(np.abs(q), 1e-300)
    u = disc_from_angle(radius * cap_angle, cap_angle) * q / radius
    u.setflags(write=False)
    return u


def focused_cap(
    counts: DomeCounts,
    pad: DomePad,
    focus: FocusOptions,
    outline: ContactOutline | None = None,
) -> np.ndarray:
    """Disc points graded around a focus on the sphere, complex, shape [nodes of the grid].

    Inside the focus cells are about ``focus.size_mm`` large, outside they grow by one factor. With
    an ``outline``, in the plane that touches the sphere there, rings follow that instead. The last
    ring lies on the cap's edge.
    """
    center, per_mm = _focus_in_disc(pad, focus.at_mm)
    scale = per_mm / (1 - abs(center) ** 2)
    rings = counts.cap_rings
    core, rho, _ = graded_rings(
        focus, rings, scale, largest_half=_LARGEST_HALF, most_even=rings - 2
    )
    zeta = np.concatenate([core, (rho * np.exp(1j * spoke_angles(focus.core))).ravel()])
    if outline is not None:
        plan = np.stack([np.real(zeta), np.imag(zeta)], axis=1) / scale
        drawn = replace(outline, points_mm=_projected(outline.points_mm, pad.dome_radius_mm))
        plan = contact_plan(plan, counts.core, rings, np.zeros(2), drawn)
        zeta = scale * (plan @ np.array([1, 1j]))
    edge_share = np.abs(_even_throughout(counts, pad.cap_angle))
    return _moved_to(center, zeta, edge_share, pad.cap_angle)


def outside_outline_mm(
    disc: np.ndarray,
    pad: DomePad,
    focus: FocusOptions,
    outline: ContactOutline,
) -> np.ndarray:
    """Approximate distance of disc points outside an outline about the focus, in its plane [mm],
    [n] -> [n]; exact to first order around the focus."""
    center, per_mm = _focus_in_disc(pad, focus.at_mm)
    zeta = disc_automorphism(disc, -center) * (1 - abs(center) ** 2) / per_mm
    return outline.distance_mm(np.stack([np.real(zeta), np.imag(zeta)], axis=1))


def _projected(points_mm: np.ndarray, sphere_mm: float) -> np.ndarray:
    """Where points over the plane that touches a sphere [mm], [n, 2], lie in the stereographic
    projection from its other pole onto that plane."""
    sine = np.linalg.norm(points_mm, axis=1, keepdims=True) / sphere_mm
    return 2 * points_mm / (1 + np.sqrt(np.maximum(1 - sine**2, 0)))


def even_cap_around(counts: DomeCounts, pad: DomePad, focus: FocusOptions) -> np.ndarray:
    """The even cap moved to a focus without its grading: what lies deep under a focused cap."""
    center, _ = _focus_in_disc(pad, focus.at_mm)
    center *= _DEEP_SHARE
    even = _even_throughout(counts, pad.cap_angle)
    return _moved_to(center, even, np.abs(even), pad.cap_angle)


def _even_throughout(counts: DomeCounts, cap_angle: float) -> np.ndarray:
    """The even cap without a ring on the window's edge."""
    return even_cap(replace(counts, window_rings=0), cap_angle, None)


def _moved_to(
    center: complex, zeta: np.ndarray, edge_share: np.ndarray, cap_angle: float
) -> np.ndarray:
    """Disc points moved by the Moebius map that takes 0 to ``center``; the last ring stays on 1.

    That map bends lines around the centre, so that points there are moved by a rotation of the
    sphere instead, which agrees with it to first order and keeps every shape.

    The map alone would leave long chords on the far side of the disc's edge, so points turn
    towards even spacing there, the more the nearer ``edge_share`` is to 1. All gradings of one grid
    share it, so that their rings turn alike.
    """
    spoke = zeta / np.maximum(np.abs(zeta), 1e-300)
    turn = np.angle(disc_automorphism(spoke, -center) * np.conj(spoke))
    beyond = np.maximum(0.0, (edge_share - _TURN_FROM) / (1 - _TURN_FROM))
    turned = zeta * np.exp(1j * _EDGE_SHARE * beyond**_EDGE_DECAY * turn)
    disc = disc_automorphism(turned, center)
    # The rotation in stereographic coordinates.
    half = np.tan(0.5 * cap_angle)
    pole = center * half
    unit = (1 - abs(center) ** 2) * half / (1 + abs(pole) ** 2)
    rotated = (unit * turned + pole) / (1 - np.conj(pole) * unit * turned) / half
    low, high = _RIGID_TO
    blend = np.clip((np.abs(turned) - low) / (high - low), 0, 1)
    disc = rotated + blend**2 * (3 - 2 * blend) * (disc - rotated)
    edge = np.isclose(edge_share, 1, rtol=0, atol=1e-12)
    disc[edge] /= np.abs(disc[edge])
    return disc


def _focus_in_disc(pad: DomePad, at_mm: tuple[float, float]) -> tuple[complex, float]:
    """Disc point over gel xy and the scale there from lengths on the cap to the disc [1/mm]."""
    theta = float(np.arcsin(np.hypot(*at_mm) / pad.dome_radius_mm))
    radius = float(disc_from_angle(np.array(theta), pad.cap_angle))
    bend = np.cos(0.5 * theta) ** 2 * np.tan(0.5 * pad.cap_angle)
    per_mm = 0.5 / (bend * pad.dome_radius_mm)
    return radius * complex(np.exp(1j * np.arctan2(at_mm[1], at_mm[0]))), float(per_mm)
