# SPDX-License-Identifier: Apache-2.0
"""Scenes that cannot be solved are refused with what was found and what is allowed."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh
from taccel_lab.scene import (
    AffineBody,
    Ball,
    Element,
    FixedJoint,
    Joint,
    KinematicBody,
    Material,
    MaterialField,
    MaterialModel,
    Plane,
    PositionDrive,
    PrismaticJoint,
    RevoluteJoint,
    Scene,
    SoftBody,
    Surface,
    TimeScheme,
    TimeStepping,
    TriangleMesh,
    VelocityDrive,
    box_mesh,
    cylinder_mesh,
    sphere_mesh,
)
from taccel_lab.solvers import SolverIPC
from taccel_lab.state import as_poses, initial_state
from tests.support.blocks import block_mesh, everywhere, pose

NAN, INF = float("nan"), float("inf")
MESH = block_mesh((2, 2, 1), (2e-3, 2e-3, 1e-3))
"""18 nodes, 24 tets."""
GEL = Material(1e5, 0.45)
BOX = box_mesh((1e-3, 1e-3, 1e-3))
DYNAMIC = TimeStepping(quasi_static=False)
MOONEY = MaterialModel.MOONEY_RIVLIN
STILL = np.array([0, 0, 0, 0, 0, 0, 1.0])


def gel(**options: Any) -> SoftBody:
    return SoftBody(MESH, GEL, **{"element": Element.LINEAR, **options})


def material(**changes: Any) -> Material:
    return Material(**{"young_modulus_pa": 1e5, "poisson_ratio": 0.4, **changes})


def field(**changes: Any) -> MaterialField:
    return MaterialField(**{"young_modulus_pa": 1e5, "poisson_ratio": 0.4, **changes})


def tets(**changes: Any) -> TetMesh:
    parts = {"nodes_m": MESH.nodes_m, "tets": MESH.tets, "faces": MESH.faces}
    return TetMesh(**{**parts, "face_regions": MESH.face_regions, **changes})


def rests(second: np.ndarray) -> None:
    rest = np.stack([MESH.nodes_m, second])
    Scene(gel(rest_positions_m=rest), env_count=2).finalize()


def on_cube(carrier: AffineBody | None = None, **options: Any) -> Scene:
    body = AffineBody(BOX, name="cube") if carrier is None else carrier
    pad = SoftBody(MESH, GEL, **{"name": "pad", "mount": "cube", **options})
    frame = KinematicBody(None, name="frame")
    return Scene(pad, frame, env_count=2, affine_bodies=body, time=DYNAMIC)


def joined(*joints: Joint) -> Scene:
    bodies = [AffineBody(BOX, name="a"), AffineBody(BOX, name="b")]
    frame = KinematicBody(None, name="k")
    return Scene((), frame, 2, DYNAMIC, affine_bodies=bodies, joints=joints)


def hinge(**options: Any) -> RevoluteJoint:
    return RevoluteJoint(**{"first": "a", "name": "j"} | options)


def fan() -> TriangleMesh:
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0]]
    return TriangleMesh(np.array(corners) * 1e-3, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]]))


def in_three(body: AffineBody) -> Scene:
    return Scene(affine_bodies=body, env_count=3, time=DYNAMIC)


def lidless() -> Scene:
    body = AffineBody(TriangleMesh(BOX.vertices_m, BOX.faces[2:]), name="peg")
    return Scene(affine_bodies=body, time=DYNAMIC)


KINDS = "must be the name of one kinematic or affine body; there are 'cube', 'frame'"
AT = pose(0, 0, 1e-3)
ON_CUBE: list[tuple[dict[str, Any], str]] = [
    ({"mount": "hand"}, f"mount 'hand' of 'pad' {KINDS}"),
    ({"mount": "frame", "mount_pose": AT}, "is for a mount that is an affine body; 'frame' is kin"),
    ({"mount": None, "mount_pose": AT}, "'pad' has a mount_pose, but no mount"),
    (
        {"mount_pose": np.tile(AT, (2, 1))},
        r"mount_pose of 'pad' must have shape .*7.*, got \[2, 7\]",
    ),
    ({"mount_pose": 2 * STILL}, "of mount_pose of 'pad' must have unit length"),
    ({"initial_pose": AT}, "'pad' has a mount: its pose is the mount's"),
    ({"initial_velocity_m_s": (0, 0, 1.0)}, "'pad' starts to move as its mount 'cube' does"),
    (
        {"carrier": AffineBody(BOX, name="cube", surface=Surface(environments=(0,)))},
        "'cube' carries 'pad': it must be present in all environments",
    ),
    (
        {"rest_positions_m": np.stack([MESH.nodes_m, MESH.nodes_m * 1.01])},
        "rest_positions_m of 'pad' must have the bonded nodes in the same places in all",
    ),
    ({"bonded_nodes": np.zeros(0, int)}, "'pad' has a mount, but no bonded nodes to hold it there"),
]
REFUSED: list[tuple[Callable[[], Any], str]] = [
    # Materials.
    (lambda: Material(-1e5, 0.4), "Young's modulus.*100 Pa.*-100000"),
    (lambda: Material(0.15, 0.4), "the unit is pascal"),
    (lambda: Material(NAN, 0.4), "Young's modulus.*nan"),
    (lambda: Material(1e5, 0.5), r"Poisson's ratio must lie in \(-1, 0.5\), got 0.5"),
    (lambda: Material(1e5, NAN), "Poisson's ratio"),
    (lambda: Material(1e5, 0.4, NAN), "density"),
    *[
        (lambda model=model: Material(1e5, 0.5, model=model), "incompressible")
        for model in MaterialModel
    ],
    *[
        (lambda make=make, changes=changes: make(**changes), words)
        for make in (material, field)
        for changes, words in (
            ({"mooney_ratio": 0.1}, "mooney_rivlin only"),
            ({"model": "mooney_rivlin"}, "model must be one of neo_hookean"),
            ({"model": MOONEY, "mooney_ratio": 1.2}, r"\[0, 1\], got 1.2"),
            ({"model": MOONEY, "mooney_ratio": NAN}, "got nan"),
            ({"model": MOONEY, "mooney_ratio": 0.5, "poisson_ratio": 0.2}, "at least 0.25"),
        )
    ],
    (lambda: Material.mooney_rivlin(-1.0, 2.0, 1e6), "c10 must be at least 0 Pa"),
    (lambda: Material.mooney_rivlin(1e4, NAN, 1e6), "c01 must be finite"),
    (lambda: Material.mooney_rivlin(0.0, 0.0, 1e6), "must be positive"),
    (lambda: Material.mooney_rivlin(1e4, 0.0, 0.0), "bulk modulus must be positive"),
    (lambda: Material.mooney_rivlin(1e4, 1e4, 2e4), "at least 0.25"),
    (lambda: field(poisson_ratio=np.array([0.4, 0.5])), "of tet 1 .*incompressible"),
    (lambda: field(young_modulus_pa=np.array([1e5, -1e5])), "of tet 1 must lie"),
    (lambda: field(young_modulus_pa=np.array([NAN, 1e5])), "of tet 0 must lie"),
    (lambda: field(density_kg_m3=np.array([1e3, 1e3, 0.0])), "density of tet 2"),
    (lambda: field(young_modulus_pa=np.full(3, 1e5), poisson_ratio=np.full(4, 0.4)), r"\(3,\)"),
    (lambda: field(young_modulus_pa=np.full((3, 1), 1e5)), r"arrays \[tet_count\]"),
    (
        lambda: field(
            poisson_ratio=np.array([0.4, 0.1]), model=MOONEY, mooney_ratio=np.array([0.3, 0.4])
        ),
        "of tet 1",
    ),
    (lambda: SoftBody(MESH, field(young_modulus_pa=np.full(5, 1e5))), "of 5 tets, the mesh has 24"),
    # Shapes.
    (lambda: Ball(0.0), "ball radius"),
    (lambda: Ball(NAN), "ball radius.*nan"),
    (lambda: Ball(4.0), "ball radius.*4000 mm"),
    (lambda: sphere_mesh(1e-3, -1.0), "edge"),
    (lambda: box_mesh((1e-3, 0.0, 1e-3)), "box edge"),
    (lambda: cylinder_mesh(1e-3, NAN), "cylinder height"),
    (lambda: cylinder_mesh(1e-3, 1e-3, segments=3), "at least 8 segments, got 3"),
    (lambda: TriangleMesh(np.zeros((4, 2)), np.array([[0, 1, 2]])), r"vertices \[n, 3\]"),
    (lambda: TriangleMesh(np.zeros((4, 3)), np.array([[0, 1, 2, 3]])), r"faces \[n, 3\]"),
    (lambda: TriangleMesh(np.full((4, 3), NAN), np.array([[0, 1, 2]])), "NaN"),
    (lambda: TriangleMesh(np.eye(4, 3), np.array([[0, 1, 4]])), "do not exist"),
    (lambda: tets(nodes_m=MESH.nodes_m * NAN), "NaN"),
    (lambda: tets(tets=MESH.tets[:, [1, 0, 2, 3]]), "inverted or flat"),
    (lambda: tets(face_regions=MESH.face_regions[1:]), "face_regions has shape"),
    (lambda: tets(nodes_m=MESH.nodes_m[:-1]), "do not exist"),
    (lambda: Scene(gel(), KinematicBody(fan())).finalize(), r"not manifold: 1 edges .*\(0, 1\)"),
    # Bodies.
    (lambda: KinematicBody(Ball(1e-3), -0.1, name="pin"), "friction coefficient of 'pin'"),
    (lambda: KinematicBody(Ball(1e-3), 11.0, name="pin"), "friction coefficient of 'pin'"),
    (lambda: AffineBody(BOX, -1.0, name="peg"), "density of 'peg'.*got -1"),
    (lambda: AffineBody(BOX, young_modulus_pa=-1e9, name="peg"), "young_modulus_pa of 'peg'"),
    (lambda: AffineBody(Ball(1e-3)), "shape must be a TriangleMesh"),  # type: ignore[arg-type]
    (lambda: AffineBody(BOX, initial_pose=np.zeros(6)), r"pose.*got \[6\]"),
    (lambda: AffineBody(BOX, initial_pose=np.zeros(7)), "unit length"),
    (lambda: AffineBody(BOX, initial_pose=pose(NAN, 0, 0)), "pose.*NaN"),
    (lambda: AffineBody(BOX, initial_velocity_m_s=(0, NAN, 0)), "initial_velocity_m_s"),
    (lambda: AffineBody(BOX, initial_spin_rad_s=(0, INF, 0)), "initial_spin_rad_s"),
    (lambda: Scene(affine_bodies=AffineBody(BOX)), "quasi_static=False"),
    (lambda: Scene(soft_bodies=()), "at least one soft or affine body"),
    (lambda: Scene(gel(), pair_friction={("gel", "nobody"): 0.3}), "'nobody', which 0 bodies"),
    (lambda: Scene([gel(), gel(name="b")], pair_friction={("gel", "b"): -1.0}), r"\[0, 10\]"),
    (lambda: Scene(gel(), KinematicBody(None, surface=Surface(environments=(0, 5))), 3), "0, 2"),
    (lambda: in_three(AffineBody(BOX, initial_pose=np.tile(STILL, (2, 1)))), "expected 3"),
    (lambda: lidless().finalize(), r"body 0 \('peg'\) is not closed: 4 edges"),
    (lambda: Plane(normal=(0, 0, 0)), "normal.*must not be zero"),
    (lambda: Plane(point_m=(0, 0, NAN)), "point_m"),
    (lambda: Surface(thickness_m=-1e-4), "thickness_m"),
    (lambda: Surface(layer=-1), "layer"),
    # Time.
    (lambda: TimeStepping(scheme="rk4"), "no scheme 'rk4'; known: euler, bdf2"),  # type: ignore[arg-type]
    *[(lambda dt=dt: TimeStepping(False, dt), "dt must lie in") for dt in (0.0, -0.01, NAN, 1e2)],
    (lambda: TimeStepping(quasi_static=False, gravity_m_s2=(0, 0, NAN)), "gravity"),
    # Without inertia it would do nothing.
    (lambda: TimeStepping(gravity_m_s2=(0, 0, -9.81)), r"gravity.*quasi_static"),
    # Gels in scenes.
    (lambda: Scene(gel(), env_count=0), "env_count must be at least 1, got 0"),
    (lambda: Scene(gel(rest_positions_m=np.zeros((2, 18, 3))), env_count=3), r"\(2, 18.*\(3, 18"),
    (lambda: Scene(gel(bonded_nodes=np.array([0, 1]))), "at least three bonded nodes"),
    (lambda: Scene(gel(bonded_nodes=np.array([0, 2, 4, 18]))).finalize(), "bonded_nodes"),
    (lambda: Scene(gel(bonded_nodes=np.arange(18))).finalize(), "bonded"),
    (lambda: rests(MESH.nodes_m * [1, 1, -1]), "environment 1 is inverted"),
    (lambda: rests(MESH.nodes_m * NAN), "environment 1"),
    *((lambda options=options: on_cube(**options), words) for options, words in ON_CUBE),
    # Joints and drives.
    (lambda: hinge(axis=(0, 0, 0)), "axis of joint 'j' must not be zero"),
    (lambda: hinge(axis=(0, NAN, 1)), "axis of joint 'j' holds NaN"),
    (lambda: hinge(anchor_m=(0, 1)), "anchor_m of joint 'j'"),
    (lambda: hinge(second="a"), "connects 'a' with itself"),
    (lambda: hinge(first=""), "needs the name of its first body"),
    (lambda: hinge(limits_deg=(10, 20)), "low <= 0 <= high"),
    (lambda: hinge(limits_deg=(NAN, 1)), "low <= 0 <= high"),
    (lambda: hinge(second_pose=np.ones(7), second="k"), "unit length"),
    (lambda: hinge(second_pose=np.ones(6), second="k"), "second_pose of joint 'j' must have shape"),
    (lambda: hinge(second_pose=STILL), "the world, which has no second_pose"),
    (lambda: hinge(drive=3.0), "must be a PositionDrive or a VelocityDrive"),
    (lambda: PositionDrive(stiffness=0), "stiffness of a drive must be positive"),
    (lambda: PositionDrive(stiffness=1, damping=-1), "damping"),
    (lambda: PositionDrive(stiffness=1, target=NAN), "target of a drive holds NaN"),
    (lambda: PositionDrive(stiffness=1, max_effort=0), "max_effort"),
    (lambda: VelocityDrive(damping=0), "damping"),
    (lambda: VelocityDrive(damping=1, max_effort=NAN), "max_effort"),
    (lambda: VelocityDrive(damping=1, target=np.zeros((2, 2))), "target"),
    (lambda: joined(FixedJoint("c")), "first of joint 'joint' must be .* one affine body, got 'c'"),
    (lambda: joined(FixedJoint("k")), "there are 'a', 'b'"),
    (lambda: joined(FixedJoint("a", "c")), "second of.*affine or kinematic body.*'a', 'b', 'k'"),
    (lambda: joined(Joint("a")), "must be a FixedJoint, RevoluteJoint or PrismaticJoint"),
    (lambda: joined(FixedJoint("a"), FixedJoint("b")), "2 joints are called 'joint'"),
    (lambda: joined(FixedJoint("a", anchor_m=np.zeros((3, 3)))), "anchor_m of.*3 rows, expected 2"),
    (lambda: joined(FixedJoint("a", "b", second_pose=STILL)), "'b' is affine and has its own init"),
    (
        lambda: joined(PrismaticJoint("a", drive=PositionDrive(1.0, target=np.zeros(3)))),
        r"drive target.*\(3,\), expected a number or \[2\]",
    ),
]


@pytest.mark.parametrize(("make", "words"), REFUSED, ids=[words for _, words in REFUSED])
def test_what_no_scene_can_have_is_refused(make: Callable[[], Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        make()


@pytest.mark.parametrize(
    ("poses", "words"),
    [
        (np.zeros((1, 7)), "poses must have shape"),
        (np.zeros((2, 1, 7)), "poses must have shape"),
        (everywhere(1, pose(NAN, 0, 0)), "NaN"),
        (np.zeros((1, 1, 7)), "unit length"),
        (everywhere(1, 2 * pose(0, 0, 1)), "unit length"),
    ],
)
def test_poses(poses: np.ndarray, words: str) -> None:
    model = Scene(gel(), (KinematicBody(Ball(1e-3)),)).finalize()
    state = initial_state(model, everywhere(1, pose(0, 0, 5e-3)))
    for take in (
        lambda: as_poses(model, poses),
        lambda: initial_state(model, poses),
        lambda: SolverIPC(model).step(state, poses),
    ):
        with pytest.raises(InputError, match=words):
            take()


def test_units_defaults_and_copies() -> None:
    joint = RevoluteJoint("a", axis=(0, 3, 4), limits_deg=(-90, 180))
    np.testing.assert_allclose(joint.axis, [0, 0.6, 0.8])
    assert joint.limits == pytest.approx((-math.pi / 2, math.pi)) and joint.motor is None
    assert PrismaticJoint("a", limits_mm=(0, 5)).limits == pytest.approx((0, 5e-3))
    assert FixedJoint("a").limits == (-INF, INF)
    for touch in (False, True):
        made = joined(RevoluteJoint("a", "b", bodies_touch=touch))
        assert made.may_touch(*made.affine_bodies) is touch
    assert TimeStepping(quasi_static=False, scheme="bdf2").scheme is TimeScheme.BDF2  # pyright: ignore
    assert material().model is field().model is MaterialModel.NEO_HOOKEAN
    mooney = Material.mooney_rivlin(c10_pa=3e4, c01_pa=1e4, bulk_modulus_pa=2e6)
    assert mooney.shear_modulus_pa == pytest.approx(8e4)
    assert mooney.lame_lambda_pa + 2 / 3 * mooney.shear_modulus_pa == pytest.approx(2e6)
    assert mooney.mooney_ratio == pytest.approx(0.25) and mooney.model is MOONEY
    # A field keeps values of its own.
    young = np.full(6, 1e5)
    kept = field(young_modulus_pa=young)
    young[:] = -1
    assert kept.largest_young_modulus_pa == 1e5
    with pytest.raises(ValueError, match="read-only"):
        np.asarray(kept.young_modulus_pa)[0] = 1
