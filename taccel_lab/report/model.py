# SPDX-License-Identifier: Apache-2.0
"""What a report shows, as plain numbers and arrays: nothing here knows how they were made.

A report without labelled circles has no section of their detection: it is left out of the page and
is null in the JSON. Images are RGB, uint8 or float levels 0..255, shape [height, width, 3].
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from taccel_lab.geometry import PixelGrid


@dataclass(frozen=True)
class ColorScore:
    """Agreement of rendered and captured images; levels of 255."""

    crop_psnr_db: float
    """Peak signal-to-noise ratio in the crop of half width 1.6 r [dB]."""
    crop_ssim: float
    """Structural similarity in the crop."""
    disc_l1: float
    """Mean absolute error in the contact disc [levels]."""
    full_l1: float
    """Mean absolute error over the whole image [levels]."""
    crop_l1: float | None = None
    """Mean absolute error in the crop [levels]."""


@dataclass(frozen=True)
class HeldoutFrame:
    """A captured press that the fit never saw, and its rendering."""

    name: str
    real_rgb: np.ndarray
    rendered_rgb: np.ndarray
    circle_px: tuple[float, float, float]
    """Contact circle (u, v, radius) [px]."""
    score: ColorScore
    background_score: ColorScore
    """The same figures for the bare background."""


@dataclass(frozen=True)
class NormalDisc:
    """Colour change that the model predicts at one pixel over the hemisphere of normals."""

    pixel_uv: tuple[float, float]
    delta_rgb: np.ndarray
    """Colour change [levels], shape [n, n, 3]: rows ny, columns nx from -max_sine to max_sine
    (``figures_color.disc_normals``); NaN outside the disc."""
    max_sine: float
    """Largest sine of the tilt that is drawn."""
    trained_sine: float | None = None
    """Largest sine of the tilt among the training pixels: beyond it the model extrapolates."""


@dataclass(frozen=True)
class LossCurve:
    """Training history."""

    steps: np.ndarray
    train: np.ndarray


@dataclass(frozen=True)
class ColorSection:
    """The pixel-to-colour model on held-out frames."""

    heldout: ColorScore
    """Mean over the held-out frames."""
    background_only: ColorScore
    frames: tuple[HeldoutFrame, ...]
    train_count: int
    discs: tuple[NormalDisc, ...]
    loss: LossCurve
    noise_floor_l1: float
    """Mean difference of captures from the background far from contact [levels]."""
    facts: Mapping[str, str | float | int]
    """Further rows: architecture, parameter count, fit time."""


@dataclass(frozen=True)
class PressRecord:
    """One simulated press at its final depth."""

    name: str
    depth_mm: float
    force_n: float
    """Normal force on the indenter [N]."""
    residual_n: float
    """Norm of the unbalanced nodal forces [N]."""
    newton_iterations: float
    """Mean Newton iterations a step."""
    seconds_per_step: float
    """Mean wall time a step, kernel compilation apart [s]."""
    min_distance_m: float
    """Smallest distance between gel and indenter over all steps [m]."""
    steps: int
    contact_radius_mm: float
    labelled_radius_mm: float | None = None


@dataclass(frozen=True)
class ForceDepth:
    """Normal force of one indenter at several depths."""

    label: str
    depth_mm: np.ndarray
    force_n: np.ndarray


@dataclass(frozen=True)
class PressMaps:
    """What the sensor reads in the reference press."""

    grid: PixelGrid
    height_m: np.ndarray
    """Shape [height_px, width_px]."""
    normals: np.ndarray
    """Shape [height_px, width_px, 3]."""
    rgb: np.ndarray | None
    """Rendered image, levels, shape [height_px, width_px, 3]; None without a colour model."""
    positions_m: np.ndarray
    """Deformed nodes, shape [node, 3]."""
    contact_faces: np.ndarray
    """Triangles of the contact face, shape [face, 3]."""
    forces_n: np.ndarray
    """Contact force on each node [N], shape [node, 3]."""
    pressures_pa: np.ndarray
    """Contact pressure at each node [Pa], shape [node]."""


@dataclass(frozen=True)
class PressSection:
    """Simulated presses."""

    reference: PressRecord
    """The press whose figures stand under ``press`` in the JSON."""
    records: tuple[PressRecord, ...]
    force_depth: ForceDepth
    maps: PressMaps
    facts: Mapping[str, str | float | int]
    """Further rows: material, friction, barrier distance, kernel compilation."""


@dataclass(frozen=True)
class MeshSection:
    """The gel's tet mesh."""

    node_count: int
    tet_count: int
    min_dihedral_deg: float
    nodes_m: np.ndarray
    """Shape [node_count, 3]."""
    faces: np.ndarray
    """Outward boundary triangles, shape [face_count, 3]."""
    face_regions: np.ndarray
    """``Region`` of each face, shape [face_count]."""
    dihedral_deg: np.ndarray
    """All dihedral angles, any shape."""
    facts: Mapping[str, str | float | int] = field(default_factory=dict)
    """Further rows: volume error, Hausdorff distance, mesher."""


@dataclass(frozen=True)
class DetectionSection:
    """Contact circles found automatically against the labels."""

    names: tuple[str, ...]
    labelled_px: np.ndarray
    """(u, v, radius), shape [frame, 3]."""
    detected_px: np.ndarray
    """The same, NaN where nothing was found."""


@dataclass(frozen=True)
class Stage:
    """Wall time of one step of the job."""

    name: str
    seconds: float


@dataclass(frozen=True)
class Target:
    """A figure with a goal; the value is looked up in the JSON by its dotted key."""

    key: str
    label: str
    goal: float
    at_least: bool
    """True when larger is better."""
    unit: str = ""
    digits: int = 2
    cause: str = ""
    """The likely cause if the goal is missed, as a sentence."""


@dataclass(frozen=True)
class Report:
    """A whole report."""

    title: str
    subtitle: str
    targets: tuple[Target, ...]
    color: ColorSection
    press: PressSection
    mesh: MeshSection
    detection: DetectionSection | None
    stages: tuple[Stage, ...]
    remarks: tuple[str, ...]
    """Sentences added to the verdict."""
    provenance: Mapping[str, str]
    """Versions, inputs with their hashes, machine, date."""
