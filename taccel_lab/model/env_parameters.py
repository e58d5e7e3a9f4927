# SPDX-License-Identifier: Apache-2.0
"""Parameters of bodies that differ by environment: what ``Model.set_body`` and ``set_friction``
write on the device.

A model has them once for all environments until the first of these calls, and from then on once
for each: ``widened`` makes the copies. Formulas and order of summation are those of the host that
builds a model (``bodies.material``, ``elastic.discretize``), and nothing is fused, so that an
environment gets the bits that a model built with its values would have.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.bodies.bodies import Element
from taccel_lab.errors import InputError
from taccel_lab.geometry.quadratic import CORNER_MASS, MIDDLE_MASS
from taccel_lab.model.elastic import ElementArrays
from taccel_lab.model.env_rows import device_array, on_device
from taccel_lab.model.launches import launch

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.kernel
def _widen_rows_kernel(source: wp.array(dtype=wp.float64), result: wp.array(dtype=wp.float64)):
    i = wp.tid()
    result[i] = source[i % source.shape[0]]


@wp.kernel
def moduli_kernel(
    mask: wp.array(dtype=wp.int32),
    given_young: wp.array2d(dtype=wp.float64),
    given_poisson: wp.array2d(dtype=wp.float64),
    first: int,
    element_count: int,
    young_moduli: wp.array(dtype=wp.float64),
    poisson_ratios: wp.array(dtype=wp.float64),
    mu: wp.array(dtype=wp.float64),
    lam: wp.array(dtype=wp.float64),
):
    """Moduli [Pa] and ratios of elements from ``first`` on, as ``env_values`` gives them; what is
    not given stays."""
    env, k = wp.tid()
    if mask[env] == 0:
        return
    i = env * element_count + first + k
    if given_young:
        young_moduli[i] = given_young[env, k % given_young.shape[1]]
    if given_poisson:
        poisson_ratios[i] = given_poisson[env, k % given_poisson.shape[1]]
    one = wp.float64(1.0)
    two = wp.float64(2.0)
    young = young_moduli[i]
    nu = poisson_ratios[i]
    mu[i] = young / (two * (one + nu))
    lam[i] = young * nu / ((one + nu) * (one - two * nu))


@wp.kernel
def largest_kernel(
    mask: wp.array(dtype=wp.int32),
    given_young: wp.array2d(dtype=wp.float64),
    body: int,
    largest: wp.array2d(dtype=wp.float64),
):
    """Keeps ``Model.largest_moduli`` with the moduli of a body [Pa]."""
    env = wp.tid()
    if mask[env] == 0:
        return
    own = wp.float64(0.0)
    for k in range(given_young.shape[1]):
        own = wp.max(own, given_young[env, k])
    largest[env, body] = own
    last = largest.shape[1] - 1
    of_all = wp.float64(0.0)
    for other in range(last):
        of_all = wp.max(of_all, largest[env, other])
    largest[env, last] = of_all


@wp.kernel
def _density_kernel(
    mask: wp.array(dtype=wp.int32),
    densities: wp.array2d(dtype=wp.float64),
    volumes: wp.array2d(dtype=wp.float64),
    first: int,
    nodes: wp.array(dtype=wp.int32),
    starts: wp.array(dtype=wp.int32),
    entries: wp.array(dtype=wp.int32),
    width: int,
    shares: wp.vec2d,
    first_node: int,
    last_node: int,
    masses: wp.array2d(dtype=wp.float64),
):
    env, n = wp.tid()
    node = nodes[n]
    if mask[env] == 0 or node < first_node or node >= last_node:
        return
    total = wp.float64(0.0)
    for k in range(starts[n], starts[n + 1]):
        element = entries[k] // width
        density = densities[env, (element - first) % densities.shape[1]]
        share = shares[0]
        if entries[k] % width >= 4:
            share = shares[1]
        total += volumes[env % volumes.shape[0], element] * density * share
    masses[env, node] = total


@wp.kernel
def _scale_kernel(
    mask: wp.array(dtype=wp.int32),
    given: wp.array2d(dtype=wp.float64),
    of_scene: wp.array(dtype=wp.float64),
    scene_masses: wp.array2d(dtype=wp.float64),
    first_node: int,
    masses: wp.array2d(dtype=wp.float64),
):
    env, n = wp.tid()
    if mask[env] == 0:
        return
    row = env % scene_masses.shape[0]
    factor = given[env, 0] / of_scene[env % of_scene.shape[0]]
    masses[env, first_node + n] = factor * scene_masses[row, first_node + n]


@wp.kernel
def set_friction_kernel(
    mask: wp.array(dtype=wp.int32),
    given: wp.array2d(dtype=wp.float64),
    first: int,
    second: int,
    pair_friction: wp.array3d(dtype=wp.float64),
):
    """Coefficient of a pair of bodies."""
    env = wp.tid()
    if mask[env] != 0:
        pair_friction[env, first, second] = given[env, 0]
        pair_friction[env, second, first] = given[env, 0]


def widened(shared: wp.array, shape: tuple[int, ...]) -> wp.array:
    """A copy of float64 with as many rows as ``shape`` says; ``shared`` has them or has one."""
    result = wp.empty(shape, dtype=wp.float64, device=shared.device)
    flat = [shared.flatten(), result.flatten()]
    launch(_widen_rows_kernel, result.size, *flat)
    return result


def env_values(
    value: Any,
    name: str,
    env_count: int,
    device: wp.Device,
    check: Callable[[float, str], None],
    mask: Any = None,
    tet_count: int = 1,
) -> wp.array:
    """A value for each environment, float64, [env_count, 1], or for each of its tets,
    [env_count, tet_count], on the device; what is there already is not copied.

    ``value``: a number for all, or an array [env_count] or [env_count, tet_count]. ``check``
    refuses bad ones of the environments of ``mask``; what is on the device is not checked for its
    values, as that would wait for the device.
    """
    shapes = [(env_count,), (env_count, tet_count)]
    allowed = " or ".join(str(list(shape)) for shape in (shapes if tet_count > 1 else shapes[:1]))
    if on_device(value):
        shared = device_array(value, name)
        if shared.dtype is not wp.float64 or shared.shape not in shapes:
            raise InputError(
                f"{name} on the device must be float64 of shape {allowed}, got "
                f"{shared.dtype.__name__} of shape {list(shared.shape)}"
            )
        if shared.device != device:
            raise InputError(f"{name} is on {shared.device}, the model is on {device}")
        return shared if shared.ndim == 2 else shared.contiguous().reshape((env_count, 1))
    try:
        found = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be numbers of shape {allowed}, got {value!r}") from None
    if found.ndim == 0:
        found = np.full(env_count, found)
    if found.shape not in shapes:
        raise InputError(
            f"{name} must be a number or of shape {allowed}, got shape {list(found.shape)}"
        )
    found = found.reshape(env_count, -1)
    _check_rows(found, check, mask)
    return wp.array(np.ascontiguousarray(found), dtype=wp.float64, device=device)


def check_mass(value: float, where: str = "") -> None:
    """Refuse a mass that no body has."""
    if not (np.isfinite(value) and 0 < value <= 1e6):
        raise InputError(f"mass{where} must lie in (0, 1e6] kg, got {value:g}")


def _check_rows(values: np.ndarray, check: Callable[[float, str], None], mask: Any) -> None:
    """Refuse bad values of the environments of ``mask``, the lowest and the highest first."""
    chosen = np.arange(len(values))
    if isinstance(mask, np.ndarray) and mask.shape == chosen.shape and mask.dtype == bool:
        chosen = chosen[mask]
    rows = values[chosen]
    if not rows.size:
        return
    worst = [np.argmax(~np.isfinite(rows)), np.argmin(rows), np.argmax(rows)]
    for place in worst:
        row = int(place) // rows.shape[1]
        check(float(rows.flat[place]), f" of environment {chosen[row]}")


def write_densities(
    group: ElementArrays,
    member: tuple[int, int, int],
    nodes: tuple[int, int],
    mask: wp.array,
    densities: wp.array,
    masses: wp.array,
) -> None:
    """Lumped masses [kg] of the nodes of one body of a group, from its densities [kg/m^3]."""
    quadratic = group.element is Element.QUADRATIC
    shares = wp.vec2d(CORNER_MASS, MIDDLE_MASS) if quadratic else wp.vec2d(0.25, 0.25)
    inputs = [mask, densities, group.volumes, member[1], group.gather_nodes, group.node_starts]
    inputs += [group.node_entries, group.nodes_per_element, shares, *nodes, masses]
    launch(_density_kernel, (len(mask), len(group.gather_nodes)), *inputs)


def write_scaled(
    nodes: tuple[int, int],
    mask: wp.array,
    given: wp.array,
    of_scene: Sequence[float],
    scene_masses: wp.array,
    masses: wp.array,
) -> None:
    """Masses [kg] of a range of nodes: those of the scene times ``given`` over ``of_scene``, one
    for all environments or one for each."""
    reference = wp.array(np.asarray(of_scene), dtype=wp.float64, device=mask.device)
    inputs = [mask, given, reference, scene_masses, nodes[0], masses]
    launch(_scale_kernel, (len(mask), nodes[1] - nodes[0]), *inputs)
