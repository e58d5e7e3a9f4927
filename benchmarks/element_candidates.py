# SPDX-License-Identifier: Apache-2.0
"""Which element: four candidates in small numpy prototypes of linear elasticity.

A bonded layer of 24 x 24 x 4 under a smooth round pressure of radius 3, a quarter of it with
symmetry planes. Error of its stiffness (the load squared over its work) against the finest mesh;
cost as stored 3x3 blocks times iterations of block-Jacobi conjugate gradients to 1e-6, which is
what a Newton step spends most of its time on when nu is near 0.5.

- ``p1``: linear tets
- ``p1 nodal``: linear tets, volumetric part of the mean dilatation around each node [Bonet and
  Burton 1998]; it couples all nodes two edges apart
- ``p2``: quadratic tets, four points
- ``p2 mean``: the same with one mean dilatation a tet [Nagtegaal, Parks and Rice 1974]

Elements with a pressure of its own that neighbours share (MINI, Taylor-Hood) make an indefinite
system, for which the solver's conjugate gradients and its projection are no use; they are left out.

    python -m taccel_lab.benchmarks.element_candidates --out benchmarks/results
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from taccel_lab.benchmarks.machine import describe_run
from taccel_lab.benchmarks.nodal_loads import surface_load, tet_rule, whole_faces
from taccel_lab.geometry import QuadraticMesh, Region, TetMesh, quadratic_mesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.geometry.quadratic import TET_EDGES
from taccel_lab.output import write_json

POISSON_RATIOS = (0.45, 0.49, 0.499)
CELLS = {"p1": (8, 12, 16, 24), "p1 nodal": (8, 12, 16), "p2": (4, 6, 8, 12), "p2 mean": (4, 6, 8)}
REFERENCE = ("p2 mean", 16)


def layer(cells: int) -> TetMesh:
    """A quarter of the layer: fine under the load, half as many cells over its thickness."""
    block = block_mesh((cells, cells, cells // 2), (1.0, 1.0, 1.0), jitter=0.1)
    unit = block.nodes_m + [0.5, 0.5, 1.0]
    plan = 12 * (0.35 * unit[:, :2] + 0.65 * unit[:, :2] ** 2.5)
    nodes = np.column_stack([plan, -4 * (1 - unit[:, 2]) ** 1.3])
    return TetMesh(nodes, block.tets, block.faces, block.face_regions)


def point_gradients(mesh: TetMesh | QuadraticMesh, point: np.ndarray) -> np.ndarray:
    """Gradients of the shape functions at a barycentric point, shape [tet, n, 3]."""
    corners = mesh.nodes_m[mesh.tets[:, :4]]
    inverse = np.linalg.inv(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2))
    b = np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)
    if mesh.tets.shape[1] == 4:
        return b
    middles = [4 * (point[j] * b[:, i] + point[i] * b[:, j]) for i, j in TET_EDGES]
    return np.concatenate([(4 * point[:, None] - 1) * b, np.stack(middles, axis=1)], axis=1)


def stiffness(kind: str, mesh: TetMesh | QuadraticMesh, poisson: float):
    """Matrix of a solid of unit Young's modulus, scipy CSR over 3 node_count coordinates."""
    from scipy import sparse

    mu = 1 / (2 * (1 + poisson))
    lam = poisson / ((1 + poisson) * (1 - 2 * poisson))
    corners = mesh.nodes_m[mesh.tets[:, :4]]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    count, width = mesh.tets.shape
    if width == 4:
        points, weights = np.full((1, 4), 0.25), np.ones(1)
    else:
        points, weights = tet_rule(2)
    matrix = np.zeros((count, 3 * width, 3 * width))
    volume_change = np.zeros((count, 3 * width))
    for point, weight in zip(points, weights, strict=True):
        g = point_gradients(mesh, point)
        scale = weight * volumes
        same = np.einsum("t,tai,tbi->tab", scale * mu, g, g)
        part = np.einsum("tab,ij->taibj", same, np.eye(3))
        part += np.einsum("t,taj,tbi->taibj", scale * mu, g, g)
        flat = g.reshape(count, -1)
        if kind in ("p1", "p2"):
            part += np.einsum("t,tai,tbj->taibj", scale * lam, g, g)
        matrix += part.reshape(matrix.shape)
        volume_change += scale[:, None] * flat
    if kind == "p2 mean":
        matrix += np.einsum("t,ta,tb->tab", lam / volumes, volume_change, volume_change)
    columns = (3 * mesh.tets[:, :, None] + np.arange(3)).reshape(count, -1)
    row, column = np.repeat(columns, 3 * width, axis=1), np.tile(columns, (1, 3 * width))
    size = 3 * mesh.node_count
    whole = sparse.coo_array((matrix.ravel(), (row.ravel(), column.ravel())), (size, size)).tocsr()
    if kind == "p1 nodal":
        patch = np.bincount(mesh.tets.ravel(), np.repeat(volumes / 4, 4), mesh.node_count)
        node, column = np.repeat(mesh.tets, 12, axis=1), np.tile(columns, (1, 4))
        value = np.tile(volume_change / 4, (1, 4))
        change = sparse.coo_array(
            (value.ravel(), (node.ravel(), column.ravel())), (mesh.node_count, size)
        ).tocsr()
        whole = whole + change.T @ sparse.diags_array(lam / patch) @ change
    return whole


def solve(matrix, load: np.ndarray, held: np.ndarray) -> tuple[np.ndarray, int, int]:
    """Displacements, iterations and stored blocks of one triangle."""
    from scipy import sparse
    from scipy.sparse.linalg import cg

    keep = sparse.diags_array((~held).ravel().astype(float))
    diagonal = sparse.diags_array(matrix.diagonal() * held.ravel())
    system = (keep @ matrix @ keep + diagonal).tocsr()
    blocks = sparse.csr_array(matrix).tobsr((3, 3))
    nodes = len(held)
    own = system.tobsr((3, 3))
    rows = np.repeat(np.arange(nodes), np.diff(own.indptr))
    inverse = np.linalg.inv(own.data[rows == own.indices])
    preconditioner = sparse.block_diag(list(inverse), format="csr")
    iterations = [0]

    def count(_: np.ndarray) -> None:
        iterations[0] += 1

    found, _ = cg(
        system, load.ravel() * keep.diagonal(), rtol=1e-6, M=preconditioner, callback=count
    )
    return found.reshape(-1, 3), iterations[0], (len(blocks.indices) + nodes) // 2


def measure(kind: str, cells: int, poisson: float) -> dict:
    """One row of the table."""
    base = layer(cells)
    mesh = quadratic_mesh(base) if kind.startswith("p2") else base
    faces = whole_faces(mesh)
    on_top = base.face_regions == Region.CONTACT

    def pressure(x: np.ndarray) -> np.ndarray:
        size = np.maximum(0.0, 1 - (x[:, :2] ** 2).sum(axis=1) / 9) ** 2
        return size[:, None] * np.array([0.0, 0.0, -1.0])

    load = surface_load(mesh, faces[on_top], pressure)
    x = mesh.nodes_m
    held = np.zeros(x.shape, dtype=bool)
    held[x[:, 2] < -4 + 1e-9] = True
    held[x[:, 0] < 1e-9, 0] = True
    held[x[:, 1] < 1e-9, 1] = True
    found, iterations, blocks = solve(stiffness(kind, mesh, poisson), load, held)
    return {
        "element": kind,
        "poisson_ratio": poisson,
        "nodes": mesh.node_count,
        "blocks": blocks,
        "cg_iterations": iterations,
        "stiffness": float(load.sum() ** 2 / (found * load).sum()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    options = parser.parse_args()
    rows = []
    for ratio in POISSON_RATIOS:
        reference = measure(*REFERENCE, ratio)["stiffness"]
        for kind, levels in CELLS.items():
            for cells in levels:
                row = measure(kind, cells, ratio)
                row["error"] = round(row.pop("stiffness") / reference - 1, 5)
                row["million_block_products"] = round(
                    1e-6 * row["blocks"] * row["cg_iterations"], 2
                )
                rows.append(row)
                print(
                    f"nu {ratio:g}  {kind:8s} {row['nodes']:6d} nodes  "
                    f"{100 * row['error']:+8.2f} %  {row['million_block_products']:7.1f} M",
                    flush=True,
                )
    write_json(
        options.out / "element_candidates.json",
        {"what": (__doc__ or "").split("\n")[0], "run": describe_run(), "rows": rows},
    )


if __name__ == "__main__":
    main()
