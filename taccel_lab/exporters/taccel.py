# SPDX-License-Identifier: Apache-2.0
"""Taccel's fabrication list of a gel pad: JSON, tets as VTK, masks and markers as a pickle.

The keys are those that ``taccel/tactile_robot.py`` reads. The pad's frame is that of Taccel's own
single sensor: metres, contact face at z = 0, touched from -z. Young's modulus and the camera are
not read from the list: they are fields of ``VBTSConfig``, written beside it.
"""

from __future__ import annotations

import pickle
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.exporters.frames import (
    TACCEL_FROM_GEL,
    effective_camera,
    image_center_mm,
    m_from_mm,
    turn,
)
from taccel_lab.exporters.mesh_files import (
    gel_surface,
    housing_box,
    tet_grid,
    write_stl,
    write_vtk,
)
from taccel_lab.exporters.record import ExportRecord
from taccel_lab.files.atomic_file import write_by, write_json
from taccel_lab.geometry import Region
from taccel_lab.geometry.tet_mesh import tet_volumes
from taccel_lab.profile import SensorProfile
from taccel_lab.signals.markers import MarkerLayout

if TYPE_CHECKING:
    import pyvista

RAY_START_M = 0.01
RESOLUTION = "profile"
"""Taccel's key of a mesh; ``pad_maxv=<key>`` is the name that it looks for by itself."""
STEM = f"pad_maxv={RESOLUTION}"


def export_taccel(profile: SensorProfile, folder: Path) -> ExportRecord:
    """Write ``tac_fabr.json``, ``vbts_config.json`` and ``meshes/``; markers where there are."""
    meshes = folder / "meshes"
    meshes.mkdir()
    # The image's middle is the origin: Taccel lays its pixels about it.
    origin_m = np.append(m_from_mm(image_center_mm(profile)), 0.0)
    mesh = profile.mesh
    grid = tet_grid(turn(TACCEL_FROM_GEL, mesh.nodes_m - origin_m), mesh.tets)
    write_vtk(meshes / f"{STEM}.vtk", grid)
    points, faces = gel_surface(mesh)
    write_stl(meshes / "pad.stl", turn(TACCEL_FROM_GEL, points - origin_m), faces)

    metadata = masks(profile, grid)
    (meshes / f"{STEM}.pkl").write_bytes(pickle.dumps(metadata, protocol=4))
    write_by(meshes / f"{STEM}.npz", partial(np.savez_compressed, **metadata))
    entry: dict[str, object] = {
        "link_name": "sensor",
        "sensor_name": profile.sensor.name,
        "mesh_path": "meshes/pad.stl",
        "reso": RESOLUTION,
        "pos": [0.0, 0.0, 0.0],
        "rot": [0.0, 0.0, 0.0],
        "mesh_vtk_file": f"meshes/{STEM}.vtk",
        "mesh_metadata_file": f"meshes/{STEM}.pkl",
    }
    if profile.housing is not None:
        points, faces = housing_box(profile.housing)
        write_stl(meshes / "shell.stl", turn(TACCEL_FROM_GEL, points - origin_m), faces)
        entry["shell_mesh_path"] = "meshes/shell.stl"
    write_json(folder / "tac_fabr.json", [entry])
    write_json(folder / "vbts_config.json", vbts_config(profile))

    camera = profile.grid()
    record = ExportRecord(
        carries={
            "gel": "tets, bonded and coated nodes; the surface as STL",
            "material": "Young's modulus, Poisson's ratio, density and friction (vbts_config.json)",
            "camera": "size and scale (vbts_config.json)",
        },
        approximations={
            "volume_error_relative": _volume_error(profile, grid),
            "scale_difference": abs(camera.mm_per_px_x / camera.mm_per_px_y - 1),
        },
        notes=[
            "frame: metres, contact face at z = 0, touched from -z; the gel frame turned half a "
            "turn about x, its origin under the middle of the image",
            "Taccel lays columns along +x and rows along +y and looks along -z, which shows a "
            "mirror image of what the sensor's camera sees: flip its rows (image[::-1]) to compare",
            "its renderer takes square images: cam_h = cam_w is the longer side of the profile's, "
            "whose image is the middle of it",
            "link_name, pos and rot place the pad on a link of your robot: change them there",
            "set the fields of vbts_config.json on each VBTSConfig after loading; Taccel reads "
            "none of them from the list",
            "coat_mask_surf and marker_vert_idx_surf count the points of VTK's extract_surface",
        ],
    )
    if profile.markers is None:
        record.leave_out_missing(profile, "markers")
    else:
        record.carries["markers"] = "barycentric coordinates in faces of the coating"
        record.left_out["markers.radius_mm"] = "Taccel draws dots of 5 px"
    if profile.optics is not None:
        record.carries["optics"] = "angle of view from the apparent distance"
    if profile.housing is not None:
        record.carries["housing"] = "its outer box, as the shell"
    if mesh.tet_layers.any():
        record.left_out["material.layers"] = "Taccel's gels are of one material: that of layer 0"
    if profile.material.model != "neo_hookean":
        record.left_out["material.model"] = (
            f"{profile.material.model}: Taccel's gels are neo-Hookean"
        )
    record.left_out["color"] = (
        "Taccel's colour network has other inputs; train it on images that this profile renders"
    )
    return record


def vbts_config(profile: SensorProfile) -> dict[str, object]:
    """Values of ``VBTSConfig``'s fields."""
    grid, material = profile.grid(), profile.material
    camera = effective_camera(profile)
    side = max(grid.width_px, grid.height_px)
    pixel_mm = float(np.sqrt(grid.mm_per_px_x * grid.mm_per_px_y))
    values: dict[str, object] = {
        "density": material.density_kg_m3,
        "E": material.young_modulus_pa,
        "nu": material.poisson_ratio,
        "mu": material.friction_coefficient,
        "cam_h": side,
        "cam_w": side,
        "cam_pixel_size": pixel_mm,
        "cam_fwd_dir": [0, 0, -1],
        "ray_axis": "z",
        "ray_start_level": RAY_START_M,
        "ray_rest_level": 0.0,
        "with_marker": profile.markers is not None,
    }
    if camera is not None:
        half_m = side * m_from_mm(pixel_mm) / 2
        values["cam_fov"] = float(np.rad2deg(2 * np.arctan(half_m / camera.distance_m)))
    return values


def masks(profile: SensorProfile, grid: pyvista.UnstructuredGrid) -> dict[str, np.ndarray]:
    """The dictionary of the metadata file, plain numpy arrays."""
    mesh = profile.mesh
    stick = np.zeros(mesh.node_count, dtype=bool)
    stick[mesh.bonded_nodes()] = True
    coat = np.zeros(mesh.node_count, dtype=bool)
    coat[mesh.region_nodes(Region.CONTACT)] = True
    # A node on the rim belongs to one of them, and Taccel moves the bonded ones.
    coat &= ~stick
    surface_nodes = _surface_nodes(grid)
    on_surface = np.full(mesh.node_count, -1, dtype=np.int64)
    on_surface[surface_nodes] = np.arange(len(surface_nodes))
    corners = np.zeros((0, 3), dtype=np.int64)
    weights = np.zeros((0, 3))
    if profile.markers is not None:
        layout = MarkerLayout.from_points(mesh, profile.markers.grid().points_mm())
        corners, weights = layout.nodes.astype(np.int64), layout.weights
    return {
        "stick_mask": stick,
        "coat_mask": coat,
        "coat_mask_surf": coat[surface_nodes],
        "surface_index": on_surface[corners],
        "marker_vert_idx": corners,
        "marker_vert_idx_surf": on_surface[corners],
        "marker_bc_coords": weights,
    }


def _surface_nodes(grid: pyvista.UnstructuredGrid) -> np.ndarray:
    """Mesh node of each point of the surface that VTK extracts, in its order."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkFiltersGeometry import vtkDataSetSurfaceFilter

    surface = vtkDataSetSurfaceFilter()
    surface.SetInputData(grid)
    surface.PassThroughPointIdsOn()
    surface.Update()
    ids = surface.GetOutput().GetPointData().GetArray("vtkOriginalPointIds")
    return vtk_to_numpy(ids).astype(np.int64)


def _volume_error(profile: SensorProfile, grid: pyvista.UnstructuredGrid) -> float:
    volume = tet_volumes(np.asarray(grid.points), profile.mesh.tets).sum()
    return float(abs(volume / profile.mesh.volumes_m3().sum() - 1))
