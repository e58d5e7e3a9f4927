# SPDX-License-Identifier: Apache-2.0
"""Ray casting in Warp: what each pixel sees of the face, and the light that falls on it.

Light of a point source reaches the coating through flat layers along a bent path. With p = n sin
(theta) conserved along it and r(p) the horizontal reach, power conservation between neighbouring
cones of rays gives the irradiance across a ray

    E = I(theta_0) p / (n_0^2 cos(theta_0) r(p) r'(p) cos(theta_gel))

which is I / d^2 when all indices are equal. The coating reflects as Lambert's albedo / pi plus a
glossy lobe of microfacets with the GGX distribution (B. Walter, S. R. Marschner, H. Li, K. E.
Torrance, "Microfacet models for refraction through rough surfaces", EGSR 2007) and Smith's
shadowing, without Fresnel's term: the coating's reflectance is taken as one number.
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor structs.
# pyright: reportArgumentType=false, reportAssignmentType=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportReturnType=false, reportAttributeAccessIssue=false

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

_PI = wp.constant(wp.float32(3.14159265358979))
_SNELL_STEPS = wp.constant(8)
_SNELL_ROUNDING = wp.constant(wp.float32(1e-6))
"""Part of the tangent that single precision cannot tell from nothing after a few operations."""


@wp.struct
class Layers:
    """Flat media between lights and gel [mm]."""

    window_z: wp.float32
    """Back of the window; equal to ``gel_z`` without one."""
    gel_z: wp.float32
    """Back of the gel."""
    n_outside: wp.float32
    n_window: wp.float32
    n_gel: wp.float32
    bend: wp.int32
    """0 for straight light."""


@wp.struct
class Gloss:
    """The coating's glossy lobe."""

    weight: wp.float32
    alpha2: wp.float32
    """Square of the GGX width."""


@wp.struct
class Arrival:
    """Light of a point source that arrives at a point of the gel."""

    direction: wp.vec3
    """Unit, from the point to where the light comes from."""
    irradiance: wp.float32
    """Irradiance across the ray, per unit of axial intensity."""


@wp.kernel
def hit_kernel(
    mesh: wp.uint64,
    vertex_normals: wp.array(dtype=wp.vec3),
    vertex_rest: wp.array(dtype=wp.vec3),
    triangles: wp.array(dtype=wp.int32),
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    # Out
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    rest: wp.array(dtype=wp.vec3),
    seen: wp.array(dtype=wp.int32),
):
    """First point of the face on each ray, seen from inside; a zero direction is no ray."""
    i = wp.tid()
    seen[i] = 0
    direction = directions[i]
    if wp.length_sq(direction) < 0.5:
        return
    hit = wp.mesh_query_ray(mesh, origins[i], direction, 1.0e4)
    if not hit.result or wp.dot(hit.normal, direction) <= 0.0:
        return
    a = triangles[3 * hit.face]
    b = triangles[3 * hit.face + 1]
    c = triangles[3 * hit.face + 2]
    w = 1.0 - hit.u - hit.v
    points[i] = origins[i] + hit.t * direction
    normal = hit.u * vertex_normals[a] + hit.v * vertex_normals[b] + w * vertex_normals[c]
    normals[i] = wp.normalize(normal)
    rest[i] = hit.u * vertex_rest[a] + hit.v * vertex_rest[b] + w * vertex_rest[c]
    seen[i] = 1


@wp.func
def _reach(p: float, height: float, n: float) -> wp.vec2:
    """Horizontal reach of a ray in a layer and its derivative over p."""
    if height <= 0.0:
        return wp.vec2(0.0, 0.0)
    root2 = n * n - p * p
    root = wp.sqrt(root2)
    return wp.vec2(height * p / root, height * n * n / (root2 * root))


@wp.func
def _passed(cos_from: float, cos_to: float, n_from: float, n_to: float) -> float:
    """Fresnel's unpolarised transmittance."""
    across = (n_from * cos_from - n_to * cos_to) / (n_from * cos_from + n_to * cos_to)
    along = (n_to * cos_from - n_from * cos_to) / (n_to * cos_from + n_from * cos_to)
    return 1.0 - 0.5 * (across * across + along * along)


@wp.func
def arriving_light(
    source: wp.vec3, axis: wp.vec3, lobe: float, point: wp.vec3, layers: Layers
) -> Arrival:
    """Light of a source with axial intensity 1 and lobe cos^n at a point of the gel."""
    out = Arrival()
    offset = point - source
    air = wp.max(layers.window_z - source[2], 0.0)
    window = wp.max(layers.gel_z - wp.max(source[2], layers.window_z), 0.0)
    gel = point[2] - wp.max(source[2], layers.gel_z)
    if layers.bend == 0 or air + window <= 0.0 or gel <= 0.0:
        distance = wp.length(offset)
        leaving = wp.dot(axis, offset) / distance
        out.direction = -offset / distance
        if leaving > 0.0:
            out.irradiance = wp.pow(leaving, lobe) / (distance * distance)
        return out
    r = wp.sqrt(offset[0] * offset[0] + offset[1] * offset[1])
    # The layer that the light starts in; tangents are of the layer with the least index, whose
    # equation is concave, so that Newton's method climbs to the root.
    n0 = layers.n_window
    least = wp.min(layers.n_gel, layers.n_window)
    if air > 0.0:
        n0 = layers.n_outside
        least = wp.min(layers.n_outside, layers.n_gel)
        if window > 0.0:
            least = wp.min(least, layers.n_window)
    tangent = r / (air + window + gel)
    for _ in range(_SNELL_STEPS):
        secant = wp.sqrt(1.0 + tangent * tangent)
        p = least * tangent / secant
        total = (
            _least_reach(tangent, secant, p, air, layers.n_outside, least)
            + _least_reach(tangent, secant, p, window, layers.n_window, least)
            + _least_reach(tangent, secant, p, gel, layers.n_gel, least)
        )
        missing = (r - total[0]) / total[1]
        tangent += missing
        if wp.abs(missing) <= _SNELL_ROUNDING * tangent:
            break
    secant = wp.sqrt(1.0 + tangent * tangent)
    p = least * tangent / secant
    total = (
        _least_reach(tangent, secant, p, air, layers.n_outside, least)
        + _least_reach(tangent, secant, p, window, layers.n_window, least)
        + _least_reach(tangent, secant, p, gel, layers.n_gel, least)
    )
    slope = total[1] * secant * secant * secant / least
    cos_air = wp.sqrt(wp.max(1.0 - p * p / (layers.n_outside * layers.n_outside), 0.0))
    cos_window = wp.sqrt(wp.max(1.0 - p * p / (layers.n_window * layers.n_window), 0.0))
    cos_gel = wp.sqrt(1.0 - p * p / (layers.n_gel * layers.n_gel))
    cos_start = cos_window
    passed = float(1.0)
    if air > 0.0:
        cos_start = cos_air
        if least == layers.n_outside:
            cos_start = 1.0 / secant
        if window > 0.0:
            passed = _passed(cos_start, cos_window, layers.n_outside, layers.n_window)
            passed *= _passed(cos_window, cos_gel, layers.n_window, layers.n_gel)
        else:
            passed = _passed(cos_start, cos_gel, layers.n_outside, layers.n_gel)
    else:
        passed = _passed(cos_start, cos_gel, layers.n_window, layers.n_gel)
    flat = wp.vec3(0.0, 0.0, 0.0)
    # p / r tends to 1 over the sum of h / n straight above the source.
    p_over_r = 1.0 / slope
    if r > 1.0e-4:
        flat = wp.vec3(offset[0] / r, offset[1] / r, 0.0)
        p_over_r = p / r
    leaving = wp.dot(axis, p / n0 * flat + wp.vec3(0.0, 0.0, cos_start))
    if leaving > 0.0:
        spread = p_over_r / (n0 * n0 * cos_start * slope * cos_gel)
        out.irradiance = passed * wp.pow(leaving, lobe) * spread
    out.direction = -(p / layers.n_gel * flat + wp.vec3(0.0, 0.0, cos_gel))
    return out


@wp.func
def _least_reach(
    tangent: float, secant: float, p: float, height: float, n: float, least: float
) -> wp.vec2:
    """Reach in a layer and its derivative over the tangent in the layer of least index."""
    if n == least:
        return wp.vec2(height * tangent, height)
    reach = _reach(p, height, n)
    return wp.vec2(reach[0], reach[1] * least / (secant * secant * secant))


@wp.func
def glossy(n: wp.vec3, to_light: wp.vec3, to_eye: wp.vec3, gloss: Gloss) -> float:
    """Microfacet reflectance [1/sr] with GGX distribution and Smith's shadowing."""
    nl = wp.dot(n, to_light)
    nv = wp.dot(n, to_eye)
    if nl <= 0.0 or nv <= 0.0:
        return 0.0
    nh = wp.dot(n, wp.normalize(to_light + to_eye))
    denominator = nh * nh * (gloss.alpha2 - 1.0) + 1.0
    spread = gloss.alpha2 / (_PI * denominator * denominator)
    smith_l = 2.0 * nl / (nl + wp.sqrt(gloss.alpha2 + (1.0 - gloss.alpha2) * nl * nl))
    smith_v = 2.0 * nv / (nv + wp.sqrt(gloss.alpha2 + (1.0 - gloss.alpha2) * nv * nv))
    return gloss.weight * spread * smith_l * smith_v / (4.0 * nl * nv)


@wp.kernel
def light_kernel(
    mesh: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    seen: wp.array(dtype=wp.int32),
    sources: wp.array(dtype=wp.vec3),
    axes: wp.array(dtype=wp.vec3),
    intensities: wp.array(dtype=wp.vec3),
    lobes: wp.array(dtype=wp.float32),
    layers: Layers,
    gloss: Gloss,
    offset_mm: float,
    cast_shadows: int,
    # Out
    vectors: wp.array(dtype=wp.mat33),
    specular: wp.array(dtype=wp.vec3),
    blocked: wp.array(dtype=wp.vec2),
):
    """Light on each seen point: by channel the irradiance vector (a row of ``vectors``, whose
    product with the inward normal is the irradiance), the glossy radiance, and the light that faces
    the point and the part of it that the face itself blocks (all channels)."""
    i = wp.tid()
    total = wp.mat33()
    shine = wp.vec3()
    shadow = wp.vec2()
    if seen[i] == 1:
        inward = -normals[i]
        start = points[i] + offset_mm * inward
        for s in range(sources.shape[0]):
            light = arriving_light(sources[s], axes[s], lobes[s], points[i], layers)
            facing = wp.dot(inward, light.direction)
            if light.irradiance > 0.0 and facing > 0.0:
                power = light.irradiance * intensities[s]
                weight = facing * (power[0] + power[1] + power[2])
                shadow[0] = shadow[0] + weight
                far = wp.length(sources[s] - points[i])
                free = bool(True)
                if cast_shadows == 1:
                    free = not wp.mesh_query_ray_anyhit(mesh, start, light.direction, far)
                if free:
                    total += wp.outer(power, light.direction)
                    reflected = glossy(inward, light.direction, -directions[i], gloss)
                    shine += reflected * facing * power
                else:
                    shadow[1] = shadow[1] + weight
    vectors[i] = total
    specular[i] = shine
    blocked[i] = shadow
