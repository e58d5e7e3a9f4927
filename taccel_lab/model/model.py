# SPDX-License-Identifier: Apache-2.0
"""``Model``: everything about a scene that a step does not change, as device arrays.

Nodes are numbered through, in this order:

    nodes of the soft bodies | four control nodes of each affine body | vertices of the affine
    bodies | vertices of the kinematic bodies (a ball has one) | an origin node for each plane

A node is *free* (a row of the Newton system: unbonded soft nodes and all control nodes),
*embedded* (a vertex of an affine body: a weighted sum of its four control nodes) or *prescribed*
(bonded soft nodes, kinematic vertices, planes).

An affine body [Lan et al. 2022, Affine Body Dynamics] has the control nodes y0, its centre of mass,
and y1..y3 = L times the columns of its linear map along its principal axes - vectors in metres, not
points. A vertex X in the principal frame is y0 + sum_k (X_k / L) y_k. In that frame the mass matrix
of the control nodes is diagonal: the mass, and the second moments over L^2.

Arrays of rest quantities have ``rest_count`` rows, which is 1 when all environments share one rest
shape and ``env_count`` otherwise; kernels index them with ``env % rest_count``. So are arrays of
physical parameters: one row until ``set_body`` or ``set_friction`` makes environments differ.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.bodies.bodies import check_friction, check_stiff_density
from taccel_lab.bodies.mass_properties import MassProperties
from taccel_lab.bodies.material import check_density, check_mooney, check_poisson, check_young
from taccel_lab.bodies.scene_description import SceneDescription
from taccel_lab.errors import InputError
from taccel_lab.model.elastic import ElementArrays
from taccel_lab.model.env_parameters import (
    check_mass,
    env_values,
    largest_kernel,
    moduli_kernel,
    set_friction_kernel,
    widened,
    write_densities,
    write_scaled,
)
from taccel_lab.model.env_rows import device_mask
from taccel_lab.model.launches import launch
from taccel_lab.model.matrix_pattern import BlockPattern
from taccel_lab.model.surface import ContactPlan, SurfaceArrays, SurfaceTrees
from taccel_lab.summary import Summary


class BodyKind(IntEnum):
    """What moves a body."""

    SOFT = 0
    AFFINE = 1
    KINEMATIC = 2
    PLANE = 3


@dataclass(frozen=True)
class BodyRange:
    """One body: where its nodes, collision faces and edges are."""

    name: str
    kind: BodyKind
    nodes: tuple[int, int]
    """First node and the one after the last; of an affine body, its surface vertices."""
    faces: tuple[int, int]
    """Range in ``surface.faces``."""
    edges: tuple[int, int]
    """Range in ``surface.edges``."""

    @property
    def node_slice(self) -> slice:
        return slice(*self.nodes)


@dataclass
class AffineArrays:
    """Affine bodies on the device, in the order of the scene."""

    control_starts: wp.array
    """First control node y0, int32, shape [affine_count]."""
    lengths: wp.array
    """L [m], float64, shape [affine_count]."""
    stiffness: wp.array
    """Young's modulus times volume [J], float64, shape [affine_count]."""
    vertex_starts: wp.array
    """First vertex node, and the one after the last body's, int32, shape [affine_count + 1]."""
    carried: wp.array
    """Bonded nodes of gels that are mounted on the bodies: embedded as vertices are, int32."""
    carried_starts: wp.array
    """Range of each body in ``carried``, int32, shape [affine_count + 1]."""
    riders: wp.array
    """The other nodes of these gels and the body of each, vec2i."""
    have_joints: wp.array
    """1 for a body with joints, int32, shape [affine_count]."""
    properties: list[MassProperties]
    first_control: int
    """Node number of the first control node."""
    count: int


@dataclass
class RigidTarget:
    """A body whose search trees live in its own frame and never change: affine or kinematic."""

    body: int
    """Body id."""
    local_positions: wp.array
    """Vertices in the frame of the trees [m], vec3d, shape [vertex_count]."""
    trees: SurfaceTrees | None
    """None for a ball and for a frame without a surface."""
    radii_m: np.ndarray
    """Largest distance of the surface, and of what is mounted, from the frame's origin [m], shape
    [rest_count], or [1] of an affine body."""


@dataclass(repr=False)
class Model(Summary):
    """Static data of a scene; shapes beside each field."""

    scene: SceneDescription
    device: wp.Device
    env_count: int
    bodies: list[BodyRange]
    """All bodies by id."""
    soft_count: int
    """Nodes of all soft bodies."""
    node_count: int
    """All nodes."""
    free_count: int
    rest_count: int
    rest_positions: wp.array
    """Rest positions [m], vec3d, shape [rest_count, node_count]; of rigid bodies in the body
    frame, of a mounted gel in the frame of its mount."""
    free_index: wp.array
    """Row of a node in the linear system, -1 when it has none, int32, shape [node_count]."""
    free_nodes: wp.array
    """Node of each row, int32, shape [free_count]."""
    masses: wp.array
    """Lumped mass [kg], float64, shape [rest_count, node_count], or [env_count, node_count] once
    masses differ by environment."""
    gravity_scale: wp.array
    """1 for nodes that gravity acts on, 0 for the control nodes y1..y3, float64, [node_count]."""
    parents: wp.array
    """First control node of the body that a vertex or bonded node is embedded in, else -1, int32,
    [node_count]."""
    weights: wp.array
    """Weights of the four control nodes of an embedded node, vec4d, shape [node_count]."""
    frame_nodes: wp.array
    """Nodes that follow a kinematic frame, int32, shape [frame_node_count]."""
    frame_ids: wp.array
    """Kinematic index of each frame node, int32, shape [frame_node_count]."""
    start_nodes: wp.array
    """Nodes that a kinematic frame places at the start, int32, shape [start_node_count]: those that
    follow it, and the others of gels that are mounted on it."""
    start_frames: wp.array
    """Kinematic index of each of them, int32, shape [start_node_count]."""
    elastic: list[ElementArrays]
    surface: SurfaceArrays
    affine: AffineArrays
    targets: list[RigidTarget]
    """Affine bodies, then kinematic bodies: those with a frame; index is the frame's number."""
    contact_plan: ContactPlan
    present: wp.array
    """1 where a body is present, int32, shape [env_count, body_count]."""
    pair_friction: wp.array
    """Coulomb coefficient of each pair of bodies, float64, shape [1, body_count, body_count], or
    [env_count, ...] once friction differs by environment."""
    largest_moduli: wp.array
    """Largest Young's modulus of each soft body [Pa], 0 of others, and in the last column of all,
    float64, shape [1, body_count + 1], or [env_count, ...] once moduli differ by environment."""
    largest_thickness_m: float
    """Largest sum of the thicknesses of two bodies [m]."""
    rubs: bool
    """Whether any pair that may touch has friction."""
    contact_in_pattern: bool
    """Whether contact of gels and affine bodies has blocks in the pattern, and needs no list."""
    pattern: BlockPattern
    row_starts: wp.array
    columns: wp.array
    diagonal: wp.array
    scene_masses: wp.array | None = None
    """``masses`` as the scene says, once they differ by environment."""
    changes: int = 0
    """How often parameters were set by environment."""
    moves: int = 0
    """How often arrays of parameters were replaced by larger ones, which stale graphs point to."""

    # Parameters by environment -----------------------------------------------------------------

    def summary(self) -> tuple[str, list[tuple[str, str]]]:
        """Return what ``repr`` shows."""
        title, rows = self.scene.summary()
        unknowns = ("unknowns", f"{3 * self.free_count} of {self.node_count} nodes")
        return f"model of a {title} on {self.device}", [*rows, unknowns]

    def set_body(
        self,
        body: str,
        *,
        young_modulus_pa: Any = None,
        poisson_ratio: Any = None,
        density_kg_m3: Any = None,
        mass_kg: Any = None,
        mask: Any = None,
    ) -> None:
        """Set physical parameters of a body in the environments of ``mask``, from the next step on.

        Each is a number, or an array with a value for each environment, [env_count]; moduli and
        densities of a soft body may also differ by tet, [env_count, tet_count]. What is left out
        stays. Arrays of numpy are checked as those of a ``Material`` are; arrays that are on the
        model's device already, such as torch tensors of float64, are read there, and not checked
        for their values. Everything follows that a model built with these values would have: the
        stiffness of the body's contacts, masses, weights, and stress of Maxwell branches.

        Args:
            body: Name of a soft body, or of an affine one, which has density and mass only: its
                modulus is there to keep it rigid.
            mass_kg: Total mass; it is spread as the scene's densities spread it. In place of
                ``density_kg_m3``.
            mask: Bool, or int32 on the device, [env_count]; all when None. Values of the other
                environments are ignored, but if the mask is on the device and they are not, they
                are checked as well.

        Raises:
            InputError: Bad values, shapes or names; nothing is changed then.
        """
        index = self._named(body)
        kind = self.bodies[index].kind
        stiffness = {"young_modulus_pa": young_modulus_pa, "poisson_ratio": poisson_ratio}
        inertia = {"density_kg_m3": density_kg_m3, "mass_kg": mass_kg}
        given = [name for name, value in (stiffness | inertia).items() if value is not None]
        if not given:
            raise InputError(f"nothing is set of body {body!r}: give a modulus, density or mass")
        if kind not in (BodyKind.SOFT, BodyKind.AFFINE):
            raise InputError(f"body {body!r} is prescribed: it has no {given[0]}")
        if kind is BodyKind.AFFINE and given[0] in stiffness:
            raise InputError(
                f"{given[0]} of {body!r} cannot be set: it is an affine body, whose stiffness only "
                "keeps it rigid; its density or mass can"
            )
        if len(given) > 1 and given[-2:] == list(inertia):
            raise InputError(f"give either density_kg_m3 or mass_kg of {body!r}, not both")
        if kind is BodyKind.SOFT:
            self._set_soft(index, stiffness, inertia, mask)
        else:
            self._set_affine(index, inertia, mask)
        self.changes += 1

    def set_friction(self, first: str, second: str, coefficient: Any, mask: Any = None) -> None:
        """Set the Coulomb coefficient of a pair of bodies in the environments of ``mask``, from the
        next step on; arguments as those of ``set_body``.

        Raises:
            InputError: Bad values, shapes or names, a pair that may not touch, or one in a scene
                without any friction, whose solvers leave it out; nothing is changed then.
        """
        a, b = sorted((self._named(first), self._named(second)))
        if (a, b) not in self.contact_plan.pairs:
            raise InputError(
                f"bodies {first!r} and {second!r} may not touch, so nothing rubs there"
            )
        if not self.rubs:
            raise InputError(
                "no pair of bodies of this scene has friction, so that its solvers leave it out: "
                f"give {first!r} and {second!r} a coefficient above 0 in the scene first"
            )
        chosen = self._mask(mask)

        def check(value: float, where: str) -> None:
            check_friction(value, f"{first!r} and {second!r}{where}")

        name = f"friction coefficient of {first!r} and {second!r}"
        value = env_values(coefficient, name, self.env_count, self.device, check, mask)
        if self.pair_friction.shape[0] < self.env_count:
            self.pair_friction = self._widened(self.pair_friction)
        launch(set_friction_kernel, len(chosen), chosen, value, a, b, self.pair_friction)
        self.changes += 1

    def _set_soft(
        self, index: int, stiffness: dict[str, Any], inertia: dict[str, Any], mask: Any
    ) -> None:
        body, material = self.bodies[index], self.scene.soft_bodies[index].material
        group, member = next(
            (group, member)
            for group in self.elastic
            for member in group.bodies
            if member[0] == index
        )
        tet_count = member[2] - member[1]
        ratio = float(np.max(getattr(material, "mooney_ratio", 0.0)))

        def check_ratio(value: float, where: str) -> None:
            check_poisson(value, where)
            check_mooney(material.model, ratio, value, where)

        checks = {
            "young_modulus_pa": check_young,
            "poisson_ratio": check_ratio,
            "density_kg_m3": check_density,
            "mass_kg": check_mass,
        }
        chosen = self._mask(mask)
        values = {
            name: env_values(
                value,
                f"{name} of {body.name!r}",
                self.env_count,
                self.device,
                checks[name],
                mask,
                1 if name == "mass_kg" else tet_count,
            )
            for name, value in (stiffness | inertia).items()
            if value is not None
        }
        young, poisson = values.get("young_modulus_pa"), values.get("poisson_ratio")
        if young is not None or poisson is not None:
            self._widen_moduli(group)
            inputs = [chosen, young, poisson, member[1], group.element_count, group.young_moduli]
            inputs += [group.poisson_ratios, group.mu, group.lam]
            launch(moduli_kernel, (len(chosen), tet_count), *inputs)
        if young is not None:
            if self.largest_moduli.shape[0] < self.env_count:
                self.largest_moduli = self._widened(self.largest_moduli)
            launch(largest_kernel, len(chosen), chosen, young, index, self.largest_moduli)
        if "density_kg_m3" in values:
            self._widen_masses()
            densities = values["density_kg_m3"]
            write_densities(group, member, body.nodes, chosen, densities, self.masses)
        elif "mass_kg" in values:
            of_scene = self._widen_masses()
            totals = of_scene.numpy()[:, body.node_slice].sum(axis=1)
            write_scaled(body.nodes, chosen, values["mass_kg"], totals, of_scene, self.masses)

    def _set_affine(self, index: int, inertia: dict[str, Any], mask: Any) -> None:
        at = index - len(self.scene.soft_bodies)
        body = self.scene.affine_bodies[at]
        chosen = self._mask(mask)
        name, value = next(item for item in inertia.items() if item[1] is not None)
        dense = name == "density_kg_m3"
        if dense and body.stated_mass is not None:
            raise InputError(f"{body.name!r} has a stated mass, not a density: set mass_kg")
        check = check_stiff_density if dense else check_mass
        whose = f"{name} of {body.name!r}"
        given = env_values(value, whose, self.env_count, self.device, check, mask)
        of_scene = body.density_kg_m3 if dense else self.affine.properties[at].mass_kg
        first = self.affine.first_control + 4 * at
        base = self._widen_masses()
        write_scaled((first, first + 4), chosen, given, [of_scene], base, self.masses)

    def _named(self, body: str) -> int:
        try:
            return self.body_id(body)
        except KeyError as error:
            raise InputError(str(error.args[0])) from None

    def _mask(self, mask: Any) -> wp.array:
        if mask is None:
            return wp.full(self.env_count, 1, dtype=wp.int32, device=self.device)
        return device_mask(mask, self.env_count, self.device)

    def _widened(self, shared: wp.array) -> wp.array:
        self.moves += 1
        return widened(shared, (self.env_count, *shared.shape[1:]))

    def _widen_moduli(self, group: ElementArrays) -> None:
        """Give each environment moduli of its own."""
        if group.young_moduli is not None:
            return
        self.moves += 1
        shape = (self.env_count * group.element_count,)

        def of_scene(name: str) -> wp.array:
            bodies = self.scene.soft_bodies
            parts = [
                np.broadcast_to(getattr(bodies[body].material, name), last - first)
                for body, first, last in group.bodies
            ]
            shared = wp.array(np.concatenate(parts), dtype=wp.float64, device=self.device)
            return widened(shared, shape)

        group.young_moduli = of_scene("young_modulus_pa")
        group.poisson_ratios = of_scene("poisson_ratio")
        group.mu, group.lam = widened(group.mu, shape), widened(group.lam, shape)
        if len(group.mooney_ratio):
            group.mooney_ratio = widened(group.mooney_ratio, shape)

    def _widen_masses(self) -> wp.array:
        """Give each environment masses of its own; returns those of the scene."""
        if self.scene_masses is None:
            self.scene_masses = self.masses
            self.masses = self._widened(self.masses)
        return self.scene_masses

    @property
    def viscous_point_count(self) -> int:
        """Points of all Maxwell branches of all elements: the length of
        ``State.viscous_inverses``."""
        return sum(len(group.branches) * group.point_count for group in self.elastic)

    @property
    def kinematic(self) -> list[BodyRange]:
        """The kinematic bodies, in the order of ``State.poses``."""
        return [body for body in self.bodies if body.kind is BodyKind.KINEMATIC]

    @property
    def kinematic_radii_m(self) -> np.ndarray:
        """Reach of each kinematic body and of what it carries from its origin, float64, shape
        [rest_count, kinematic_count]."""
        found = [target.radii_m for target in self.targets[self.affine.count :]]
        return np.stack(found, axis=1) if found else np.zeros((self.rest_count, 0))

    def body_rows(self) -> np.ndarray:
        """First row of each body in the Newton system and the one after the last, int64, shape
        [body_count, 2]; empty ranges for prescribed bodies."""
        rows = np.zeros((len(self.bodies), 2), dtype=np.int64)
        free, first = self.free_nodes.numpy(), self.free_count - 4 * self.affine.count
        for index, body in enumerate(self.bodies):
            if body.kind is BodyKind.SOFT:
                rows[index] = np.searchsorted(free, body.nodes)
            elif body.kind is BodyKind.AFFINE:
                rows[index] = first, first + 4
                first += 4
        return rows

    def held_rows(self) -> np.ndarray:
        """Find the rows of the Newton system that share an element with a prescribed node, bool,
        [free_count]."""
        held, index = np.zeros(self.free_count, dtype=bool), self.free_index.numpy()
        for group in self.elastic:
            rows = index[group.elements.numpy()]
            rows = rows[(rows < 0).any(axis=1)]
            held[rows[rows >= 0]] = True
        return held

    def body_id(self, name: str) -> int:
        """Id of the one body of that name; KeyError names what there is."""
        found = [i for i, body in enumerate(self.bodies) if body.name == name]
        if len(found) != 1:
            names = ", ".join(repr(body.name) for body in self.bodies)
            raise KeyError(f"{len(found)} bodies are called {name!r}; there are {names}")
        return found[0]
