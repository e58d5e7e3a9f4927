# SPDX-License-Identifier: Apache-2.0
"""Contact, bond and window of a part: as selected, named in the file, or proposed.

What nobody selects and no name says is proposed: the gel is glued by its largest plane side,
touched on what faces away from that, and seen through a face inside the glued one, or through a
rectangle in its middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.cad.gel_import.importer import FaceInfo, FaceSelection, PartFaces, listing, right_of
from taccel_lab.cad.gel_import.selection import direction, rectangle_of, select_faces
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region

REGIONS: dict[str, Region] = {
    "contact": Region.CONTACT,
    "bond": Region.BOND,
    "window": Region.WINDOW,
}
_SIDES = ("-z", "-y", "-x", "+x", "+y", "+z")
"""Where a glued side is looked for, the first of equal ones wins."""
_AS_LARGE = 0.99
_AXIS = 1 - 1e-6
_WINDOW_SHARES = (0.8, 0.7, 0.6, 0.5, 0.4, 0.3)
"""Sides of a proposed window over those of the glued face, the first that fits."""
_GRID = 12


@dataclass(frozen=True)
class Labelling:
    """What each face is for, and how the part lies in its file."""

    selection: FaceSelection
    """Selection, completed."""
    assumed: dict[str, str]
    """What was not stated, by the field's name, in words."""
    regions: list[Region]
    """Region of each face."""
    rectangle: tuple[float, float] | None
    """Window to split off the bond [mm]."""
    outline: np.ndarray | None
    """Its corners in the frame and the unit of the file, [4, 3]."""
    rotation: np.ndarray
    """Gel from file, without scale, [3, 3]."""


def label_faces(faces: PartFaces, selection: FaceSelection, scale: float = 1.0) -> Labelling:
    """Complete and apply ``selection``; ``scale`` is the millimetres of a unit of the file.

    Raises InputError, with the list of faces, where a selector chooses nothing or a face twice, and
    where nothing can be proposed.
    """
    assumed = selection.assumed()
    stated = selection.model_fields_set
    selection = _with_bond(selection, faces.table)
    selection = _with_normal(selection, faces.table)
    selection = _with_contact(selection, faces.table)
    rotation = _rotation(selection)
    selection = _with_window(selection, faces, scale * rotation)
    again = FaceSelection(normal=selection.normal, right=selection.right).assumed()
    assumed = {name: again.get(name, text) for name, text in assumed.items()}
    if "normal" in assumed:
        assumed["normal"] = f"{selection.normal} of the file points out of the gel"
    for name in REGIONS:
        chosen = getattr(selection, name)
        if name not in stated and chosen != FaceSelection.model_fields[name].default:
            assumed[name] = f"{' '.join(chosen)}, as --{name} takes it"
    regions, rectangle = _regions(faces.table, selection)
    outline = None
    if rectangle is not None:
        points, shift = _in_gel(selection, faces, scale * rotation)
        bond = np.array([region == Region.BOND for region in regions])[faces.face_of]
        heights = _level(points[faces.triangles[bond]])[:, 0, 2]
        x, y = rectangle[0] / 2, rectangle[1] / 2
        z = heights.max(initial=points[:, 2].min())
        corners = np.array([[-x, -y, z], [x, -y, z], [x, y, z], [-x, y, z]])
        outline = (corners - shift) @ rotation / scale
    return Labelling(selection, assumed, regions, rectangle, outline, rotation)


def _in_gel(
    selection: FaceSelection, faces: PartFaces, turn: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The part's points [mm] in the gel frame, and their shift there."""
    points, shift = faces.vertices @ turn.T, np.zeros(3)
    if selection.origin == "center":
        contact = select_faces(selection.contact, faces.table, "contact")
        touched = np.isin(faces.face_of, list(contact))
        shift = center_shift(points, faces.triangles, touched)
    return points + shift, shift


def _level(corners: np.ndarray) -> np.ndarray:
    """Triangles square to the normal, [n, 3, 3]."""
    return corners[np.ptp(corners[..., 2], axis=1) < 1e-6]


def propose(faces: PartFaces, selection: FaceSelection) -> tuple[Labelling | None, str]:
    """Labels faces as ``label_faces``; or gives None and the first line of why not."""
    try:
        return label_faces(faces, selection), ""
    except InputError as error:
        return None, str(error).partition("\n")[0]


def center_shift(points_mm: np.ndarray, triangles: np.ndarray, contact: np.ndarray) -> np.ndarray:
    """Shift [mm], [3], to the gel frame: the middle in plan, the apex of the contact triangles."""
    low, high = points_mm[triangles].min(axis=(0, 1)), points_mm[triangles].max(axis=(0, 1))
    apex = points_mm[triangles[contact]][..., 2].max()
    return -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, apex])


def _named(selection: FaceSelection, name: str, table: Sequence[FaceInfo]) -> bool:
    """Whether a region's faces are stated, or named in the file."""
    return name in selection.model_fields_set or any(info.name == name for info in table)


def _with_bond(selection: FaceSelection, table: Sequence[FaceInfo]) -> FaceSelection:
    if _named(selection, "bond", table):
        return selection
    sides = _SIDES
    if "normal" in selection.model_fields_set:
        direction(selection.normal)
        axis = selection.normal.strip()[-1]
        sides = (("+" if selection.normal.strip().startswith("-") else "-") + axis,)
    best, largest = "", 0.0
    for side in sides:
        chosen = _outermost(side, table)
        area = sum(table[k].area_mm2 for k in chosen)
        if area * _AS_LARGE > largest:
            best, largest = side, area
    if not best:
        raise InputError(
            f"no plane face that faces {' or '.join(sides)} can be proposed as the glued "
            f"back; select one with --bond\n{listing(table)}"
        )
    return selection.model_copy(update={"bond": (f"plane:{best}",)})


def _outermost(side: str, table: Sequence[FaceInfo]) -> set[int]:
    try:
        return select_faces((f"plane:{side}",), table, "bond")
    except InputError:
        return set()


def _with_normal(selection: FaceSelection, table: Sequence[FaceInfo]) -> FaceSelection:
    """Away from a bond that is plane and square to an axis, unless stated."""
    if "normal" in selection.model_fields_set:
        return selection
    bond = select_faces(selection.bond, table, "bond")
    if not bond or any(table[k].kind != "plane" for k in bond):
        return selection
    normals = np.array([table[k].normal for k in bond])
    for side in _SIDES:
        if (normals @ direction(side) < -_AXIS).all():
            return selection.model_copy(update={"normal": side})
    return selection


def _with_contact(selection: FaceSelection, table: Sequence[FaceInfo]) -> FaceSelection:
    if _named(selection, "contact", table):
        return selection
    selector = f"normal:{selection.normal}"
    select_faces((selector,), table, "contact")
    return selection.model_copy(update={"contact": (selector,)})


def _with_window(selection: FaceSelection, faces: PartFaces, turn: np.ndarray) -> FaceSelection:
    if _named(selection, "window", faces.table):
        return selection
    bond = select_faces(selection.bond, faces.table, "bond")
    points, _ = _in_gel(selection, faces, turn)
    inner = _inner_face(bond, faces, points)
    if inner is not None:
        rest = ",".join(str(k) for k in sorted(bond - {inner}))
        return selection.model_copy(
            update={"window": (f"index:{inner}",), "bond": (f"index:{rest}",)}
        )
    size = _rectangle_in(points[faces.triangles[np.isin(faces.face_of, list(bond))]])
    if size is None:
        raise InputError(
            f"no window can be proposed, since no rectangle about the gel's middle lies on "
            f"the glued plane; select faces with --window\n{listing(faces.table)}"
        )
    return selection.model_copy(update={"window": (f"rect:{size[0]:g}x{size[1]:g}",)})


def _inner_face(bond: set[int], faces: PartFaces, points: np.ndarray) -> int | None:
    """A glued face whose plan lies inside that of another one."""
    boxes = {}
    for k in bond:
        plan = points[faces.triangles[faces.face_of == k]][..., :2].reshape(-1, 2)
        boxes[k] = plan.min(axis=0), plan.max(axis=0)
    for k, (low, high) in boxes.items():
        for other, (below, above) in boxes.items():
            if other != k and (low > below).all() and (high < above).all():
                return k
    return None


def _rectangle_in(corners: np.ndarray) -> tuple[float, float] | None:
    """Largest rectangle of ``_WINDOW_SHARES`` about the origin on level triangles [mm]."""
    level = _level(corners)
    if not len(level):
        return None
    extents = 2 * np.abs(level[..., :2]).reshape(-1, 2).max(axis=0)
    steps = np.linspace(-0.5, 0.5, _GRID)
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    for share in _WINDOW_SHARES:
        size = np.floor(10 * share * extents) / 10
        if size.min() > 0 and _covered(grid * size, level[..., :2]).all():
            return float(size[0]), float(size[1])
    return None


def _covered(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Which points lie on any of some triangles in a plane, [n, 2], [m, 3, 2] -> [n]."""
    covered = np.zeros(len(points), dtype=bool)
    for a, b, c in triangles:
        ahead = [_turn(a, b, points), _turn(b, c, points), _turn(c, a, points)]
        covered |= (np.min(ahead, axis=0) >= -1e-9) | (np.max(ahead, axis=0) <= 1e-9)
    return covered


def _turn(a: np.ndarray, b: np.ndarray, points: np.ndarray) -> np.ndarray:
    to = points - a
    return (b[0] - a[0]) * to[:, 1] - (b[1] - a[1]) * to[:, 0]


def _rotation(selection: FaceSelection) -> np.ndarray:
    """Gel from file: z along ``normal``, x along ``right``."""
    z = direction(selection.normal)
    right = selection.right or right_of(selection.normal)
    x = direction(right)
    if abs(float(x @ z)) > 0.5:
        raise InputError(f"right = {right} lies along normal = {selection.normal}; name another")
    return np.stack([x, np.cross(z, x), z])


def _regions(
    table: Sequence[FaceInfo], selection: FaceSelection
) -> tuple[list[Region], tuple[float, float] | None]:
    """Region of each face, and the size of the window to split off."""
    regions = [Region.SIDE] * len(table)
    rectangle = rectangle_of(selection.window)
    for name, region in REGIONS.items():
        if region == Region.WINDOW and rectangle is not None:
            continue
        chosen = select_faces(getattr(selection, name), table, name)
        if not chosen:
            raise InputError(f"no faces are selected for {name}\n{listing(table)}")
        for index in sorted(chosen):
            if regions[index] != Region.SIDE:
                raise InputError(
                    f"face {index} is selected for {regions[index].name.lower()} and for "
                    f"{name}\n{listing(table)}"
                )
            regions[index] = region
    return regions, rectangle
