# SPDX-License-Identifier: Apache-2.0
"""A sensor profile in memory: validated blocks and the arrays they describe."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, TetMesh
from taccel_lab.guards import unknown
from taccel_lab.profile.consistency import check_mesh_size, disagreements
from taccel_lab.profile.optical_design import OpticalDesign
from taccel_lab.profile.optional_blocks import (
    CoatingBlock,
    DepthResponseBlock,
    ForceBlock,
    HousingBlock,
    LightsBlock,
    MarkersBlock,
    NormalsBlock,
    OpticsBlock,
    PerturbationBlock,
    WindowBlock,
)
from taccel_lab.profile.schema import (
    BackgroundBlock,
    Block,
    CameraBlock,
    ColorBlock,
    GelBlock,
    MaterialBlock,
    SensorBlock,
)
from taccel_lab.profile.sensor_view import (
    BLOCK_TYPES,
    MAIN_VIEW,
    MOST_VIEWS,
    OPTIONAL_BLOCKS,
    SensorView,
    require_view_name,
)
from taccel_lab.summary import Summary

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Block key -> field of SensorProfile that holds the array(s) the block describes.
ARRAY_FIELDS = {
    "gel": "mesh",
    "background": "background_rgb",
    "color": "color_weights",
    "normals": "normal_weights",
    "force": "force_weights",
}


@dataclass(frozen=True, eq=False, repr=False)
class SensorProfile(Summary):
    """Everything that is known of one sensor. Pure data: no device arrays, no handles.

    Profiles never change; ``with_block`` and ``without`` return new ones. Image and weights are
    read-only copies of what was given.
    """

    sensor: SensorBlock
    gel: GelBlock
    material: MaterialBlock
    camera: CameraBlock
    mesh: TetMesh
    """The gel pad's mesh [m]."""
    optics: OpticsBlock | None = None
    window: WindowBlock | None = None
    coating: CoatingBlock | None = None
    lights: LightsBlock | None = None
    markers: MarkersBlock | None = None
    housing: HousingBlock | None = None
    background: BackgroundBlock | None = None
    background_rgb: np.ndarray | None = None
    """Image of the untouched sensor, RGB levels 0..255, uint8 or float32, shape [H, W, 3]."""
    color: ColorBlock | None = None
    color_weights: Mapping[str, np.ndarray] | None = None
    """Weights of the colour model by name; ``color.architecture`` says how they combine."""
    normals: NormalsBlock | None = None
    normal_weights: Mapping[str, np.ndarray] | None = None
    """Weights of the model from colour to normal by name."""
    depth_response: DepthResponseBlock | None = None
    perturbation: PerturbationBlock | None = None
    force: ForceBlock | None = None
    force_weights: Mapping[str, np.ndarray] | None = None
    """Weights of the model from image to force by name."""
    views: Mapping[str, SensorView] = dataclasses.field(default_factory=dict)
    """Further cameras by name, see ``seen_by``; all else here is of the main camera."""

    def __post_init__(self) -> None:
        self._check_mesh()
        self._check_background()
        for key in ("color", "normals", "force"):
            self._check_weights(key)
        if lines := list(disagreements(self)):
            raise InputError("\n".join(lines))
        self._check_views()

    def grid(self) -> PixelGrid:
        """Return the pixel grid of the tactile image."""
        return self.camera.grid()

    def view_names(self) -> tuple[str, ...]:
        """Return the names of all cameras, ``main`` first."""
        return (MAIN_VIEW, *self.views)

    def seen_by(self, name: str) -> Self:
        """Return the sensor with one of its cameras and no other: an ordinary profile.

        Gel, material, window, coating, lights, markers and housing are shared.
        """
        if name == MAIN_VIEW:
            return dataclasses.replace(self, views={}) if self.views else self
        if name not in self.views:
            more = unknown(name, self.view_names())
            raise InputError(f"{self.sensor.name} has no view {name!r}{more}")
        return dataclasses.replace(self, views={}, **self.views[name].parts())

    def with_view(self, name: str, seen: SensorProfile) -> Self:
        """Return a profile with the camera of ``seen`` and what was fitted to its images under that
        name; ``main`` puts it in the place of the profile's own."""
        view = SensorView.of(seen)
        if name == MAIN_VIEW:
            return dataclasses.replace(self, **view.parts())
        return dataclasses.replace(self, views={**self.views, name: view})

    def untouched(
        self, given: np.ndarray | None = None, name: str = "the background"
    ) -> np.ndarray:
        """Image of the untouched sensor, RGB levels, shape [H, W, 3]: ``given``, which an error
        calls ``name``, or the profile's; InputError without either, or for another size."""
        image = self.background_rgb if given is None else np.asarray(given)
        if image is None:
            raise InputError(
                "the profile has no background; give an image of the untouched sensor "
                "(--background)"
            )
        width, height = self.camera.width_px, self.camera.height_px
        if image.shape != (height, width, 3):
            raise InputError(
                f"{name} is {image.shape[1]}x{image.shape[0]} px, the profile's camera "
                f"{width}x{height} px; give images of that size"
            )
        return image

    def blocks(self) -> dict[str, Block]:
        """Return the blocks that are present, by key, in the order of the file."""
        found = {block.key: getattr(self, block.key) for block in BLOCK_TYPES}
        return {key: block for key, block in found.items() if block is not None}

    def summary(self) -> tuple[str, list[tuple[str, str]]]:
        """Size, stiffness and pixels, then each block with where it comes from."""
        gel, camera, material = self.gel, self.camera, self.material
        rows = [
            *(("note", remark) for remark in self.sensor.provenance.remarks),
            ("gel", f"{gel.thickness_mm:.4g} mm thick, {gel.node_count} nodes"),
            (
                "material",
                f"E {1e-3 * material.young_modulus_pa:.4g} kPa, nu {material.poisson_ratio:.4g}, "
                f"friction {material.friction_coefficient:.3g}",
            ),
            (
                "pixels",
                f"{camera.width_px} x {camera.height_px} px of {camera.mm_per_px_x:.4g} x "
                f"{camera.mm_per_px_y:.4g} mm",
            ),
        ]
        if self.views:
            rows.append(("views", ", ".join(self.view_names())))
        for key, block in self.blocks().items():
            if key == "sensor":
                continue
            provenance = block.provenance
            residuals = ", ".join(
                f"{name} {value:.4g}" for name, value in list(provenance.residuals.items())[:2]
            )
            rows.append((f"[{key}]", provenance.kind + (f": {residuals}" if residuals else "")))
        family = "" if self.sensor.family == self.sensor.name else f" ({self.sensor.family})"
        return f"profile of {self.sensor.name}{family}", rows

    def plot(self) -> Figure:
        """Draw the untouched image with its dots, or the gel's mesh where no image is known."""
        from taccel_lab.report.figures import draw_image_at_rest, draw_mesh

        if self.background_rgb is None:
            mesh = self.mesh
            return draw_mesh(mesh.nodes_m, mesh.faces, mesh.face_regions)
        dots_mm = None if self.markers is None else self.markers.grid().points_mm()
        return draw_image_at_rest(self.background_rgb, self.grid(), dots_mm)

    def optical_design(self) -> OpticalDesign | None:
        """Camera, lights, coating and window; None without the blocks ``optics``, ``lights`` and
        ``coating``."""
        if self.optics is None or self.lights is None or self.coating is None:
            return None
        return OpticalDesign(
            camera=self.optics.camera(),
            lights=self.lights.lights(),
            coating=self.coating.coating(),
            window=None if self.window is None else self.window.window(),
            gel_refractive_index=self.optics.gel_refractive_index,
            ambient_rgb=self.optics.ambient_rgb,
            gel_scattering_per_mm=self.optics.gel_scattering_per_mm,
        )

    def with_block(
        self,
        block: Block,
        arrays: TetMesh | np.ndarray | Mapping[str, np.ndarray] | None = None,
    ) -> Self:
        """Return a profile with ``block`` added or replaced.

        ``arrays`` is what the block describes: a TetMesh for a GelBlock, an RGB image for a
        BackgroundBlock, named weights for a ColorBlock, NormalsBlock or ForceBlock, nothing for the
        others. A camera of another image size needs ``without("background", "color")`` first.
        """
        changes: dict[str, Any] = {block.key: block}
        if block.key in ARRAY_FIELDS:
            if arrays is None:
                raise InputError(
                    f"a {block.key} block needs its {ARRAY_FIELDS[block.key]}, got none"
                )
            changes[ARRAY_FIELDS[block.key]] = arrays
        elif arrays is not None:
            raise InputError(f"a {block.key} block takes no arrays")
        return dataclasses.replace(self, **changes)

    def without(self, *keys: str) -> Self:
        """Return a profile that lacks the named optional blocks and their arrays."""
        changes: dict[str, Any] = {}
        for key in keys:
            if key not in OPTIONAL_BLOCKS:
                more = unknown(key, sorted(OPTIONAL_BLOCKS), they_are="optional")
                raise InputError(f"a profile cannot lack {key!r}{more}")
            changes[key] = None
            if key in ARRAY_FIELDS:
                changes[ARRAY_FIELDS[key]] = None
        return dataclasses.replace(self, **changes)

    def _check_mesh(self) -> None:
        for name in ("node_count", "tet_count"):
            stated, found = getattr(self.gel, name), getattr(self.mesh, name)
            if stated != found:
                raise InputError(f"gel.{name} is {stated} but the mesh has {found}")
        highest, stated = int(self.mesh.tet_layers.max()), len(self.material.layers)
        if highest > stated:
            raise InputError(
                f"the mesh has tets of layer {highest}, but material.layers states {stated} of them"
            )
        check_mesh_size(self.mesh, self.gel.thickness_mm)

    def _check_views(self) -> None:
        if len(self.views) >= MOST_VIEWS:
            raise InputError(f"views: {len(self.views)} of them; allowed: up to {MOST_VIEWS - 1}")
        for name in self.views:
            require_view_name(name)
        given, found = dict(self.views), {}
        for name, view in given.items():
            try:
                seen = dataclasses.replace(self, views={}, **view.parts())
            except InputError as fault:
                lines = str(fault).splitlines()
                raise InputError("\n".join(f"views.{name}: {line}" for line in lines)) from None
            # Arrays are from here on copies that nobody can write.
            found[name] = SensorView.of(seen)
        object.__setattr__(self, "views", found)

    def _check_background(self) -> None:
        if (self.background is None) != (self.background_rgb is None):
            raise InputError("a background block and its image come together; one is missing")
        if self.background_rgb is None:
            return
        image = np.array(self.background_rgb)
        expected = (self.camera.height_px, self.camera.width_px, 3)
        if image.shape != expected:
            raise InputError(
                f"the background has shape {list(image.shape)}, the camera block asks for "
                f"{list(expected)} (height, width, RGB)"
            )
        if image.dtype not in (np.uint8, np.float32):
            raise InputError(f"the background must be uint8 or float32, got {image.dtype}")
        if not np.isfinite(image).all():
            raise InputError("the background holds NaN or infinite values")
        if image.min() < 0 or image.max() > 255:
            raise InputError(
                f"the background must hold levels 0..255, found {image.min()}..{image.max()}"
            )
        image.setflags(write=False)
        object.__setattr__(self, "background_rgb", image)

    def _check_weights(self, key: str) -> None:
        field = ARRAY_FIELDS[key]
        given = getattr(self, field)
        if (getattr(self, key) is None) != (given is None):
            raise InputError(f"a {key} block and its weights come together; one is missing")
        if given is None:
            return
        if not given:
            raise InputError(f"the {key} model has no weights")
        weights = {}
        for name, value in given.items():
            array = np.array(value)
            if array.dtype not in (np.float32, np.float64):
                raise InputError(
                    f"{key} weight {name!r} must be float32 or float64, got {array.dtype}"
                )
            if not np.isfinite(array).all():
                raise InputError(f"{key} weight {name!r} holds NaN or infinite values")
            array.setflags(write=False)
            weights[name] = array
        object.__setattr__(self, field, MappingProxyType(weights))
        # Most designs have no network, and a design is made for each of a study.
        from taccel_lab.networks.judge import network_fault

        block = getattr(self, key)
        size_px = (self.camera.width_px, self.camera.height_px)
        region = block.provenance.valid_region
        if fault := network_fault(key, block.architecture, weights, size_px, region):
            raise InputError(f"{key}: {fault}")
