# SPDX-License-Identifier: Apache-2.0
"""TACTO's sensor configuration: camera, gel and lights in metres, x out of the gel.

S. Wang et al., "TACTO", RA-L 2022; the keys are those that ``tacto/renderer.py`` reads. Its camera
looks along its own -z with y up (OpenGL) and has a single angle of view; its gel is a rectangle, or
one bent like a piece of a sphere.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from taccel_lab.exporters.frames import (
    LINK_FROM_GEL,
    effective_camera,
    euler_xyz,
    image_center_mm,
    m_from_mm,
    turn,
)
from taccel_lab.exporters.mesh_files import gel_surface, write_stl
from taccel_lab.exporters.record import ExportRecord, required
from taccel_lab.files.atomic_file import write_image
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.profile import SensorProfile
from taccel_lab.profile.optical_design import Light

MOST_LIGHTS = 8
"""OpenGL's limit, which TACTO keeps for each camera."""
UPRIGHT = 0.1
"""Cosine to z below which a face counts as a wall."""
LEAST_NODES = 20
"""Least nodes in the image that are fitted alone; with fewer, the whole contact face is fitted."""
FLAT_M = 2e-5
"""Gels with less sag are exported as flat."""
_GL_FROM_OPTICAL = np.diag([1.0, -1.0, -1.0])


def export_tacto(profile: SensorProfile, folder: Path) -> ExportRecord:
    """Write ``config.yml`` and ``gel.stl``; needs the blocks optics and lights."""
    import yaml

    camera = required(profile, "optics", "a TACTO configuration", effective_camera(profile))
    block = required(profile, "lights", "a TACTO configuration", profile.lights)
    lights, moved_mm = merged_lights(
        [piece for light in block.lights() for piece in light.straight_pieces()]
    )
    rotation = LINK_FROM_GEL @ camera.gel_from_camera @ _GL_FROM_OPTICAL
    angles = [round(float(np.rad2deg(a)), 9) + 0.0 for a in euler_xyz(rotation)]
    gel, errors = _gel(profile)
    strongest = max(max(light.rgb) for light in lights)
    noise = 0.0 if profile.perturbation is None else profile.perturbation.noise_levels
    document = {
        "sensor": {
            "camera": [
                {
                    "cam0": None,
                    "position": _list(LINK_FROM_GEL @ m_from_mm(camera.position_mm)),
                    "orientation": angles,
                    "yfov": float(np.rad2deg(camera.fov_y_rad)),
                    "znear": 0.001,
                    "lightIDList": list(range(len(lights))),
                }
            ],
            "gel": gel,
            "lights": {
                "origin": [0.0, 0.0, 0.0],
                "polar": False,
                "xyz": {
                    "coords": [
                        _list(LINK_FROM_GEL @ m_from_mm(np.array(light.position_mm)))
                        for light in lights
                    ]
                },
                "xrtheta": {"xs": [], "rs": [], "thetas": []},
                "colors": [_list(np.array(light.rgb) / max(light.rgb)) for light in lights],
                "intensities": [float(max(light.rgb) / strongest) for light in lights],
            },
            "noise": {"color": {"mean": 0, "std": float(noise)}},
            "force": {
                "enable": True,
                "range_force": [0, 100],
                "max_deformation": float(m_from_mm(profile.gel.thickness_mm / 4)),
            },
        }
    }
    text = "# Sensor configuration for TACTO, written by taccel-lab. Metres, degrees.\n"
    text += yaml.safe_dump(document, sort_keys=False, default_flow_style=None)
    (folder / "config.yml").write_text(text, encoding="utf-8")
    points, faces = gel_surface(profile.mesh)
    write_stl(folder / "gel.stl", turn(LINK_FROM_GEL, points), faces)
    if profile.background_rgb is not None:
        write_image(folder / "background.png", profile.background_rgb)

    record = ExportRecord(
        carries={
            "optics": "pose and angle of view, without distortion and refraction",
            "lights": "positions and colours as point lights",
            "gel": "extent and sag; the exact surface is in gel.stl",
            "camera": "the part of the gel that the image shows",
        },
        approximations={
            **errors,
            "lights_moved_mm": moved_mm,
            "apparent_distance_mm": camera.distance_m * 1e3,
            "scale_difference": abs(profile.camera.mm_per_px_x / profile.camera.mm_per_px_y - 1),
        },
        notes=[
            "frame: x out of the gel, y left and z up in the image, origin at the gel's apex; the "
            "rendered image has the profile's rows and columns",
            f"Sensor(width={camera.width_px}, height={camera.height_px}, "
            "config_path='config.yml', background=cv2.imread('background.png'))",
            "force: TACTO's own pairing of force and indentation, with a quarter of the gel's "
            "thickness at 100 N; it does not come from the material block",
            "gel.mesh is not set, as TACTO looks for it relative to the working directory; "
            "gel.stl is that mesh",
        ],
    )
    if profile.background_rgb is not None:
        record.carries["background"] = "as background.png, 8 bit"
    if profile.perturbation is not None:
        record.carries["perturbation"] = "the noise of a pixel"
    record.leave_out_missing(profile, "background", "perturbation")
    record.left_out["lights.shape"] = "size, direction and lobe of an LED have no place"
    record.no_place_for(profile, "material", "color", "coating", "window", "markers")
    record.dots_stand_still(profile)
    return record


def merged_lights(lights: list[Light]) -> tuple[list[Light], float]:
    """Lights, eight at most, and how far the one that moved most has moved [mm].

    Neighbours are joined pair by pair, nearest first, at the middle of their power.
    """
    groups = [[light] for light in lights]
    while len(groups) > MOST_LIGHTS:
        centers = np.array([_center(group) for group in groups])
        apart = np.linalg.norm(centers[:, None] - centers[None], axis=-1)
        np.fill_diagonal(apart, np.inf)
        first, second = sorted(np.unravel_index(int(apart.argmin()), apart.shape))
        groups[first] += groups.pop(second)
    merged, moved = [], 0.0
    for group in groups:
        if len(group) == 1:
            merged += group
            continue
        center = _center(group)
        moved = max(moved, *(float(np.linalg.norm(light.position_mm - center)) for light in group))
        red, green, blue = np.sum([light.rgb for light in group], axis=0)
        x, y, z = center
        merged.append(
            Light((float(x), float(y), float(z)), group[0].direction,
                  (float(red), float(green), float(blue)), name=group[0].name)
        )  # fmt: skip
    return merged, moved


def _center(group: list[Light]) -> np.ndarray:
    power = np.array([sum(light.rgb) for light in group])
    return power @ np.array([light.position_mm for light in group]) / power.sum()


def _gel(profile: SensorProfile) -> tuple[dict[str, object], dict[str, float]]:
    """The table ``gel``, and how far TACTO's surface is from the mesh."""
    mesh = profile.mesh
    nodes = mesh.nodes_m[_upper_nodes(mesh)]
    low, high = nodes[:, :2].min(axis=0), nodes[:, :2].max(axis=0)
    width, height = high - low
    center = np.append((low + high) / 2, nodes[:, 2].max())
    # The image shows a part of the gel: the surface has to fit there.
    grid = profile.grid()
    uv = grid.pixel_from_gel(nodes[:, :2] * 1e3)
    seen = ((uv > -0.5) & (uv < [grid.width_px - 0.5, grid.height_px - 0.5])).all(axis=1)
    seen = seen if seen.sum() >= LEAST_NODES else np.ones_like(seen)
    across = nodes[seen, :2] - center[:2]
    sag = center[2] - nodes[seen, 2]
    curved = bool(sag.max() > FLAT_M)
    radius, depth = _best_sphere(across, sag, float(np.hypot(width, height) / 2))
    off = sag - (depth * sphere_sag(across, radius, width, height) if curved else 0.0)
    table: dict[str, object] = {
        "origin": _list(LINK_FROM_GEL @ center),
        "width": float(width),
        "height": float(height),
        "curvature": curved,
        "curvatureMax": depth if curved else 0.0,
        "R": radius,
        "countW": 100,
    }
    middle = image_center_mm(profile)
    return table, {
        "gel_surface_rms_mm": float(np.sqrt((off**2).mean())) * 1e3,
        "gel_surface_max_mm": float(np.abs(off).max()) * 1e3,
        "image_center_off_gel_center_mm": float(np.hypot(*(middle - center[:2] * 1e3))),
    }


def _upper_nodes(mesh: TetMesh) -> np.ndarray:
    """Nodes of the contact face where the camera sees it, without walls that stand upright."""
    faces = mesh.region_faces(Region.CONTACT)
    a, b, c = (mesh.nodes_m[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    return np.unique(faces[normals[:, 2] > UPRIGHT * np.linalg.norm(normals, axis=1)])


def sphere_sag(across_m: np.ndarray, radius: float, width: float, height: float) -> np.ndarray:
    """TACTO's sag as a share of ``curvatureMax``, which the corners of its rectangle reach."""

    def sag(squared: np.ndarray | float) -> np.ndarray:
        return radius - np.sqrt(np.maximum(0.0, radius**2 - squared))

    return sag((across_m**2).sum(axis=-1)) / sag((width**2 + height**2) / 4)


def _best_sphere(across: np.ndarray, sag: np.ndarray, corner: float) -> tuple[float, float]:
    """Radius and greatest sag [m] by least squares over the mesh's nodes."""
    from scipy.optimize import minimize_scalar

    def depth_of(log_radius: float) -> tuple[float, float]:
        shape = sphere_sag(across, np.exp(log_radius), np.sqrt(2) * corner, np.sqrt(2) * corner)
        depth = float(shape @ sag / (shape @ shape))
        return depth, float(((depth * shape - sag) ** 2).sum())

    # A hemisphere ends before the rectangle's corners do: the radius may be below theirs.
    grid = np.linspace(np.log(0.4 * corner), np.log(1e3 * corner), 80)
    best = int(np.argmin([depth_of(radius)[1] for radius in grid]))
    found = minimize_scalar(
        lambda log_radius: depth_of(log_radius)[1] * 1e12,
        bounds=(grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]),
        method="bounded",
    )
    return float(np.exp(found.x)), depth_of(float(found.x))[0]


def _list(values: np.ndarray) -> list[float]:
    return [float(value) + 0.0 for value in values]
