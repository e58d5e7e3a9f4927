# SPDX-License-Identifier: Apache-2.0
"""Convergence of linear and quadratic tets towards solutions that are known, by Poisson's ratio.

Two problems of linear elasticity (the element matrices at rest, a sparse direct solver):

*Swirl*: a cube held all around, under the body force of the divergence-free displacement
(d psi/dy, -d psi/dx, 0), psi = sin^2 pi x sin^2 pi y sin^2 pi z. Smooth, so that the error falls
with the order of the element. Error: L2 norm over that of the displacement.

*Cook's membrane* [Cook, Malkus and Plesha 1989] in plane strain, a sheet of one tet between two
frictionless walls, even cells. Referee: scikit-fem 12, plane strain, triangles of order four on
meshes of 2^r x 2^r cells graded towards the clamped corners, extrapolated over r. Error: energy of
the load, which the corner where the clamped edge meets the free one keeps from converging with the
order of any element: near it stress goes to infinity.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from taccel_lab.geometry import QuadraticMesh, TetMesh
from taccel_lab.geometry.block import block_mesh, labelled
from taccel_lab.geometry.quadratic import TET_EDGES
from taccel_lab.scene import Element, Material, Scene, SoftBody
from tests.verification.elements import ElementForces

YOUNG_PA = 1e5
CUBE_M = 1e-2
COOK_ENERGY = {0.3: 22.0122, 0.49: 18.7928, 0.499: 18.5881}
"""Work of a unit load on a membrane of unit thickness and modulus, lengths 48, 44, 16: referee."""
COOK_THICKNESS = 8.0


Field = Callable[[np.ndarray], np.ndarray]
"""Vectors [n, 3] at points [n, 3] [m]."""
Rule = tuple[np.ndarray, np.ndarray]
"""Barycentric points [q, corner] and weights [q] of sum 1."""


def tet_rule() -> Rule:
    g, w = np.polynomial.legendre.leggauss(4)
    g, w = (g + 1) / 2, w / 2
    a, b, c = (v.ravel() for v in np.meshgrid(g, g, g, indexing="ij"))
    weight = np.einsum("i,j,k->ijk", w, w, w).ravel() * 6 * (1 - a) ** 2 * (1 - b)
    b, c = b * (1 - a), c * (1 - a) * (1 - b)
    return np.stack([1 - a - b - c, a, b, c], axis=1), weight


def face_rule() -> Rule:
    g, w = np.polynomial.legendre.leggauss(4)
    g, w = (g + 1) / 2, w / 2
    a, b = (v.ravel() for v in np.meshgrid(g, g, indexing="ij"))
    weight = np.outer(w, w).ravel() * 2 * (1 - a)
    return np.stack([1 - a - b * (1 - a), a, b * (1 - a)], axis=1), weight


def shape_functions(point: np.ndarray, node_count: int) -> np.ndarray:
    """Values of the shape functions of a tet or triangle, linear or quadratic, at a point."""
    corners = len(point)
    if node_count == corners:
        return point
    edges = TET_EDGES if corners == 4 else ((0, 1), (1, 2), (2, 0))
    middles = [4 * point[i] * point[j] for i, j in edges]
    return np.array([*(point * (2 * point - 1)), *middles])


def _load(
    mesh: TetMesh | QuadraticMesh, elements: np.ndarray, sizes: np.ndarray, rule: Rule, field: Field
) -> np.ndarray:
    """Nodal forces [N] of a force per volume or area, shape [node_count, 3]."""
    corners = mesh.nodes_m[elements[:, : rule[0].shape[1]]]
    load = np.zeros((mesh.node_count, 3))
    for point, weight in zip(*rule, strict=True):
        force = field(np.einsum("k,tkd->td", point, corners)) * (weight * sizes)[:, None]
        for local, value in enumerate(shape_functions(point, elements.shape[1])):
            np.add.at(load, elements[:, local], value * force)
    return load


def body_load(mesh: TetMesh | QuadraticMesh, force_n_m3: Field) -> np.ndarray:
    """Nodal forces [N] of a force per volume, shape [node_count, 3]."""
    corners = mesh.nodes_m[mesh.tets[:, :4]]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    return _load(mesh, mesh.tets, volumes, tet_rule(), force_n_m3)


def whole_faces(mesh: TetMesh | QuadraticMesh) -> np.ndarray:
    """Boundary faces as elements: three corners, then, if quadratic, the middles 01, 12, 20."""
    if isinstance(mesh, TetMesh):
        return mesh.faces
    parts = mesh.faces.reshape(-1, 4, 3)
    columns = [parts[:, 0, 0], parts[:, 1, 1], parts[:, 2, 2]]
    return np.stack([*columns, parts[:, 3, 0], parts[:, 3, 1], parts[:, 3, 2]], axis=1)


def surface_load(
    mesh: TetMesh | QuadraticMesh, faces: np.ndarray, traction_pa: Field
) -> np.ndarray:
    """Nodal forces [N] of a traction on some of ``whole_faces``, shape [node_count, 3]."""
    corners = mesh.nodes_m[faces[:, :3]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1) / 2
    return _load(mesh, faces, areas, face_rule(), traction_pa)


def _grid(cells: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    mesh = block_mesh(cells, (1.0, 1.0, 1.0))
    return mesh.nodes_m + [0.5, 0.5, 1.0], mesh.tets


def _problem(
    nodes_m: np.ndarray, tets: np.ndarray, held: np.ndarray, element: Element, poisson: float
) -> tuple[ElementForces, TetMesh | QuadraticMesh]:
    body = SoftBody(labelled(nodes_m, tets), Material(YOUNG_PA, poisson), held, element=element)
    return ElementForces(Scene(body).finalize()), body.nodal_mesh


def _swirl(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and minus its Laplacian, over a unit length, at points of the unit cube."""
    s, c = np.sin(np.pi * points), np.cos(np.pi * points)
    f, d = s**2, 2 * np.pi * s * c
    dd, ddd = 2 * np.pi**2 * (c**2 - s**2), -8 * np.pi**3 * s * c
    x, y, z = range(3)
    zero = np.zeros(len(points))
    u = f[:, x] * d[:, y] * f[:, z]
    v = d[:, x] * f[:, y] * f[:, z]
    lap_u = (dd[:, x] * d[:, y] + f[:, x] * ddd[:, y]) * f[:, z] + f[:, x] * d[:, y] * dd[:, z]
    lap_v = (ddd[:, x] * f[:, y] + d[:, x] * dd[:, y]) * f[:, z] + d[:, x] * f[:, y] * dd[:, z]
    return np.stack([u, -v, zero], axis=1), -np.stack([lap_u, -lap_v, zero], axis=1)


def swirl_error(element: Element, cells: int, poisson: float) -> float:
    """Relative error of the displacement in the L2 norm."""
    unit, tets = _grid((cells, cells, cells))
    inside = np.all((unit > 0) & (unit < 1), axis=1)
    moves = np.random.default_rng(0).uniform(-0.1, 0.1, unit.shape) / cells
    nodes = CUBE_M * (unit + moves * inside[:, None])
    forces, full = _problem(nodes, tets, np.flatnonzero(~inside), element, poisson)
    mu = YOUNG_PA / (2 * (1 + poisson))
    load = body_load(full, lambda x: mu * _swirl(x / CUBE_M)[1] / CUBE_M**2)
    found = forces.linear_response(load)
    corners = full.nodes_m[full.tets[:, :4]]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1])
    error = norm = 0.0
    for point, weight in zip(*tet_rule(), strict=True):
        exact = _swirl(np.einsum("k,tkd->td", point, corners) / CUBE_M)[0]
        shapes = shape_functions(point, full.tets.shape[1])
        here = np.einsum("k,tkd->td", shapes, found[full.tets])
        error += weight * (volumes * ((here - exact) ** 2).sum(axis=1)).sum()
        norm += weight * (volumes * (exact**2).sum(axis=1)).sum()
    return float(np.sqrt(error / norm))


def _cook_points(unit: np.ndarray) -> np.ndarray:
    """The membrane [mm] from the unit square, shape [n, 2]."""
    s, t = unit[:, 0], unit[:, 1]
    return np.stack([48 * s, 44 * s * (1 - t) + (44 + 16 * s) * t], axis=1)


def cook_error(element: Element, cells: int, poisson: float) -> float:
    """Relative error of the energy of the load; negative when too stiff."""
    unit, tets = _grid((cells, cells, 1))
    nodes = np.concatenate([_cook_points(unit), COOK_THICKNESS * unit[:, 2:]], axis=1)
    held = np.flatnonzero(unit[:, 0] == 0)
    forces, full = _problem(1e-3 * nodes, tets, held, element, poisson)
    x_mm = 1e3 * full.nodes_m
    faces = whole_faces(full)
    faces = faces[(x_mm[faces[:, :3], 0] > 48 - 1e-9).all(axis=1)]
    pressure_pa = 1.0 / (16e-3 * COOK_THICKNESS * 1e-3)
    load = surface_load(full, faces, lambda x: np.tile([0.0, pressure_pa, 0.0], (len(x), 1)))
    fixed = np.zeros(x_mm.shape, dtype=bool)
    fixed[:, 2] = (x_mm[:, 2] < 1e-9) | (x_mm[:, 2] > COOK_THICKNESS - 1e-9)
    work = (forces.linear_response(load, fixed) * load).sum()
    unit_work = work * YOUNG_PA * COOK_THICKNESS * 1e-3
    return float(unit_work / COOK_ENERGY[poisson] - 1)


def rate(cells: list[int], errors: list[float]) -> float:
    slope = np.polyfit(np.log(cells), np.log(np.abs(errors)), 1)[0]
    return float(-slope)


def referee(poisson: float) -> float:
    import skfem  # pyright: ignore[reportMissingImports]
    from skfem.models.elasticity import linear_elasticity  # pyright: ignore[reportMissingImports]

    lam = poisson / ((1 + poisson) * (1 - 2 * poisson))
    energies = []
    for level in (3, 4, 5, 6):
        even = np.linspace(0, 1, 2**level + 1)
        mesh = skfem.MeshTri.init_tensor(even**2, (1 - np.cos(np.pi * even)) / 2)
        mesh = skfem.MeshTri(_cook_points(mesh.p.T).T, mesh.t)
        element = skfem.ElementVector(skfem.ElementTriP4())
        basis = skfem.Basis(mesh, element, intorder=8)
        matrix = linear_elasticity(lam, 1 / (2 * (1 + poisson))).assemble(basis)
        right = skfem.FacetBasis(
            mesh, element, facets=mesh.facets_satisfying(lambda x: np.isclose(x[0], 48))
        )
        load = skfem.LinearForm(lambda v, w: v[1] / 16).assemble(right)
        held = basis.get_dofs(mesh.facets_satisfying(lambda x: np.isclose(x[0], 0)))
        energies.append(load @ skfem.solve(*skfem.condense(matrix, load, D=held)))
    last, before, first = energies[-1], energies[-2], energies[-3]
    return float(last + (last - before) / ((before - first) / (last - before) - 1))
