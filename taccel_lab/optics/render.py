# SPDX-License-Identifier: Apache-2.0
"""What the camera of a design would see of its gel, untouched or pressed.

Sight lines are bent once per design; each frame then casts them, and shadow rays towards the
lights, against the deformed face.
"""

# Warp's type stubs know no structs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.camera.gel_camera import CameraModel, GelCamera, resized
from taccel_lab.camera.refraction import (
    OUTSIDE_INDEX,
    FlatMedia,
    Media,
    flat_back_z_mm,
    glued_back_mm,
    media_between,
    without_refraction,
)
from taccel_lab.errors import InputError
from taccel_lab.geometry import QuadraticMesh, TetMesh
from taccel_lab.guards import require_range
from taccel_lab.optics.frames import (
    Display,
    LightField,
    PreviewImage,
    WhiteBalance,
    exposed,
    marker_factor,
    turbid_reflectance,
)
from taccel_lab.optics.light_samples import sample_lights
from taccel_lab.optics.shading_kernels import Gloss, Layers, hit_kernel, light_kernel
from taccel_lab.optics.surface import FineFace, GelFace
from taccel_lab.processes.start_warp import start_warp
from taccel_lab.profile.optical_design import MarkerGrid, OpticalDesign

wp.set_module_options({"enable_backward": False})


class OpticalModel:
    """Renders one design; ``render`` at rest and pressed share exposure and white balance."""

    def __init__(
        self,
        design: OpticalDesign,
        mesh: TetMesh | QuadraticMesh | None,
        *,
        size_px: tuple[int, int] | None = None,
        markers: MarkerGrid | None = None,
        refraction: bool = True,
        shadows: bool = True,
        samples: int = 4,
        level: float | tuple[float, float, float] = 110.0,
        gamma: float = 2.2,
        white_balance: WhiteBalance = "gray",
        face: FineFace | None = None,
        back_mm: np.ndarray | None = None,
        media: Media | None = None,
        designed: TetMesh | None = None,
        device: Any = "cpu",
    ) -> None:
        """
        Args:
            design: Camera, lights, coating, window.
            mesh: Gel at rest, in metres; None when ``face`` and ``back_mm`` are given.
            size_px: Width and height of the preview; the camera's own when None.
            markers: Dots on the contact face.
            refraction: Whether sight lines and light bend at window and gel.
            shadows: Whether the face casts shadows on itself.
            samples: Points at most that stand for an LED; see ``sample_lights``.
            level: Median grey level of the untouched gel, by which exposure is set; one for each
                channel to match a real sensor.
            gamma: Exponent of the camera's response.
            white_balance: gray or none; see ``exposed``.
            face: A rigid face in place of a mesh's, such as a formula's.
            back_mm: Points on the glued back of ``face`` [mm], shape [n, 3].
            media: What bends sight lines; window and gel of the design when None. Light goes
                through those in any case.
            designed: The gel as designed, where ``mesh`` is coarser; see ``GelFace``.
            device: Warp device.

        Raises:
            InputError: Sizes out of range, a gel whose back does not fit the window, or a camera
                that sees nothing of the gel or no light.
        """
        require_range("samples", samples, 1, 1024)
        camera = design.camera
        if size_px is not None:
            require_range("size_px", size_px, 2, 8192)
            camera = resized(camera, *size_px)
        self.design = design
        self.camera = CameraModel(camera)
        self.markers = markers
        start_warp()
        self.device = device
        self._shadows = shadows
        self._gel: GelFace | None = None
        if mesh is not None:
            self._gel = GelFace(mesh, designed=designed, device=device)
            face, back_mm = self._gel.rest, glued_back_mm(mesh)
        if face is None or back_mm is None:
            raise InputError("an optical model needs a mesh, or a face with the points of its back")
        self.rest_face = face
        bent_media = media or media_between(design, back_mm)
        self.media: Media = bent_media if refraction else without_refraction(bent_media)
        self._back_z_mm = flat_back_z_mm(back_mm)
        self._layers = self._light_layers(refraction)
        self._origins, self._directions, self.passed = self._sight_lines()
        """The last: share of a point's light that reaches the image, shape [H, W]."""
        self._lights = sample_lights(design.lights, samples)
        self._upload(face)
        light = self.light_field()
        self._ambient = self._ambient_light(light)
        linear = self.radiance(light)
        self.display: Display = exposed(
            linear, light.mask, level=level, gamma=gamma, white_balance=white_balance
        )
        """Exposure of all frames."""
        self._rest_linear = linear

    @classmethod
    def through(
        cls,
        camera: GelCamera,
        design: OpticalDesign,
        mesh: TetMesh | QuadraticMesh,
        **options: Any,
    ) -> OpticalModel:
        """Model of a design whose picture is that of ``camera``, as all its other channels are;
        ``options`` as of the constructor."""
        seen = dataclasses.replace(design, camera=camera.camera)
        return cls(seen, mesh, media=camera.media, **options)

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the image."""
        return self.camera.camera.width_px, self.camera.camera.height_px

    @property
    def rest_rgb(self) -> np.ndarray:
        """The image at rest, uint8 [H, W, 3], without the light being followed again for it: that
        of ``render().rgb``, of the design and markers that the model was made with."""
        return self.display.rgb(self._rest_linear)

    def render(self, positions_m: Any = None) -> PreviewImage:
        """Render the image of the gel.

        Args:
            positions_m: Node positions in the gel frame [m], shape [node, 3] or [env, node, 3],
                numpy or Warp array; at rest when None.
        """
        if positions_m is None:
            return self.picture(self.light_field())
        positions = positions_m.numpy() if hasattr(positions_m, "numpy") else positions_m
        positions = np.asarray(positions, dtype=np.float64)
        if positions.ndim == 2:
            return self.picture(self.light_field(positions))
        if positions.ndim != 3 or len(positions) == 0:
            raise InputError(f"positions has shape {positions.shape}; [env, node, 3] is needed")
        frames = [self.picture(self.light_field(env)) for env in positions]
        names = ("rgb", "linear", "mask", "points_mm", "normals")
        return PreviewImage(*(np.stack([getattr(f, name) for f in frames]) for name in names))

    def light_field(self, positions_m: np.ndarray | None = None) -> LightField:
        """Light on what each pixel sees, for node positions [m] of one environment or at rest."""
        face = self.rest_face
        if positions_m is not None:
            if self._gel is None:
                raise InputError("a model made from a formula has no nodes to move")
            face = self._gel.at(positions_m)
        return self.light_of(face)

    def light_of(self, face: FineFace) -> LightField:
        """Light on what each pixel sees of a face."""
        self._place(face)
        width, height = self.size_px
        count = width * height
        outputs = {
            "points": wp.zeros(count, dtype=wp.vec3, device=self.device),
            "normals": wp.zeros(count, dtype=wp.vec3, device=self.device),
            "rest": wp.zeros(count, dtype=wp.vec3, device=self.device),
            "seen": wp.zeros(count, dtype=wp.int32, device=self.device),
        }
        wp.launch(
            hit_kernel,
            dim=count,
            inputs=[
                self._mesh.id,
                self._vertex_normals,
                self._vertex_rest,
                self._mesh.indices,
                self._origins,
                self._directions,
            ],
            outputs=list(outputs.values()),
            device=self.device,
        )
        vectors = wp.zeros(count, dtype=wp.mat33, device=self.device)
        specular = wp.zeros(count, dtype=wp.vec3, device=self.device)
        blocked = wp.zeros(count, dtype=wp.vec2, device=self.device)
        wp.launch(
            light_kernel,
            dim=count,
            inputs=[
                self._mesh.id,
                outputs["points"],
                outputs["normals"],
                self._directions,
                outputs["seen"],
                *self._light_arrays,
                self._layers,
                self._gloss,
                max(0.005, 0.03 * self.rest_face.edge_mm),
                int(self._shadows and self.design.gel_scattering_per_mm == 0),
            ],
            outputs=[vectors, specular, blocked],
            device=self.device,
        )
        shape = (height, width)
        mask = outputs["seen"].numpy().reshape(shape) == 1
        shadow = blocked.numpy().reshape(*shape, 2)

        def seen_only(name: str) -> np.ndarray:
            values = outputs[name].numpy().reshape(*shape, 3).copy()
            values[~mask] = np.nan
            return values

        return LightField(
            vectors=vectors.numpy().reshape(*shape, 3, 3),
            specular=specular.numpy().reshape(*shape, 3),
            facing=shadow[..., 0],
            blocked=shadow[..., 1],
            points_mm=seen_only("points"),
            normals=seen_only("normals"),
            rest_mm=seen_only("rest"),
            mask=mask,
        )

    def reflectance(self, light: LightField, *, markers: bool = True) -> np.ndarray:
        """Diffuse reflectance of what each pixel sees, with or without dots, shape [H, W, 3]."""
        albedo = np.broadcast_to(
            np.array(self.design.coating.albedo_rgb, dtype=np.float32), light.points_mm.shape
        )
        scattering = self.design.gel_scattering_per_mm
        if markers and self.markers is not None:
            albedo = albedo * marker_factor(self.markers, light)[..., None]
        if scattering > 0:
            if self._back_z_mm is None:
                raise InputError("a turbid gel needs a flat back: its depth is counted from there")
            depth = np.maximum(light.points_mm[..., 2:] - self._back_z_mm, 0.0)
            albedo = turbid_reflectance(albedo, scattering * depth)
        return albedo

    def picture(self, light: LightField) -> PreviewImage:
        """Render the image of a light field."""
        linear = self.radiance(light)
        return PreviewImage(
            rgb=self.display.rgb(linear),
            linear=linear,
            mask=light.mask,
            points_mm=light.points_mm,
            normals=light.normals,
        )

    def radiance(self, light: LightField, *, markers: bool = True) -> np.ndarray:
        """Radiance that reaches the camera, float32, shape [H, W, 3]; 0 outside the mask."""
        irradiance = self._diffuse_irradiance(light) + self._ambient
        radiance = self.reflectance(light, markers=markers) / math.pi * irradiance + light.specular
        linear = np.where(light.mask[..., None], radiance * self.passed[..., None], 0.0)
        return linear.astype(np.float32)

    def _diffuse_irradiance(self, light: LightField) -> np.ndarray:
        if self.design.gel_scattering_per_mm == 0:
            return np.where(light.mask[..., None], light.irradiance(), 0.0)
        # A turbid gel forgets the direction of light: what counts is the light across its layer.
        return np.maximum(-light.vectors[..., 2], 0.0)

    def _ambient_light(self, light: LightField) -> np.ndarray:
        share = np.array(self.design.ambient_rgb)
        if not light.mask.any():
            raise InputError(
                "no pixel of the camera sees the gel's contact face; the camera stands at "
                f"{self.design.camera.position_mm} mm in the gel frame"
            )
        return share * self._diffuse_irradiance(light)[light.mask].mean(axis=0)

    def _light_layers(self, refraction: bool) -> Layers:
        window = self.design.window
        layers = Layers()
        back = self._back_z_mm
        layers.gel_z = back if back is not None else 0.0
        thickness = window.thickness_mm if window is not None else 0.0
        layers.window_z = layers.gel_z - thickness
        layers.n_outside = OUTSIDE_INDEX
        layers.n_gel = self.design.gel_refractive_index
        layers.n_window = window.refractive_index if window is not None else layers.n_gel
        layers.bend = int(refraction and back is not None)
        return layers

    def _sight_lines(self) -> tuple[wp.array, wp.array, np.ndarray]:
        """Origins and directions in the gel of all pixels, and how bright each arrives."""
        width, height = self.size_px
        uv = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
        origin, directions = self.camera.rays(uv)
        entries, bent, passed = self.media.trace(origin, directions)
        window = self.design.window
        if window is not None and isinstance(self.media, FlatMedia) and self.media.planes_mm:
            half = 0.5 * np.array(window.size_mm)
            beside = (np.abs(entries[..., :2]) > half).any(axis=-1)
            bent = np.where(np.expand_dims(beside, -1), np.nan, bent)
        camera = self.camera.camera
        if camera.model == "pinhole":
            axis = camera.gel_from_camera()[:, 2]
            passed = passed * np.maximum(directions @ axis, 0.0) ** camera.falloff
        lost = ~np.isfinite(bent).all(axis=-1)
        entries[lost], bent[lost], passed[lost] = 0.0, 0.0, 0.0
        vectors = [
            wp.array(a.reshape(-1, 3).astype(np.float32), dtype=wp.vec3, device=self.device)
            for a in (entries, bent)
        ]
        return vectors[0], vectors[1], passed.astype(np.float32)

    def _upload(self, face: FineFace) -> None:
        def vectors(values: np.ndarray) -> wp.array:
            return wp.array(values.astype(np.float32), dtype=wp.vec3, device=self.device)

        self._mesh = wp.Mesh(
            points=vectors(face.points_mm),
            indices=wp.array(face.triangles.ravel(), dtype=wp.int32, device=self.device),
        )
        self._vertex_normals = vectors(face.normals)
        self._vertex_rest = vectors(face.points_mm)
        self._placed = face
        s = self._lights
        self._light_arrays = [
            vectors(s.positions_mm),
            vectors(s.axes),
            vectors(s.intensities),
            wp.array(s.lobes.astype(np.float32), dtype=wp.float32, device=self.device),
        ]
        self._gloss = Gloss()
        self._gloss.weight = self.design.coating.specular
        self._gloss.alpha2 = self.design.coating.roughness**2

    def _place(self, face: FineFace) -> None:
        if face is self._placed:
            return
        self._mesh.points.assign(face.points_mm.astype(np.float32))
        self._vertex_normals.assign(face.normals.astype(np.float32))
        self._mesh.refit()
        self._placed = face
