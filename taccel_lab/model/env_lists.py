# SPDX-License-Identifier: Apache-2.0
"""Environments that a launch works on: those of a mask, or of a mask and a list.

A launch over all environments costs its threads even where a mask holds one: of 4,096 environments,
an iteration of a single one takes a GPU as long as one of three hundred. A list has those few next
to each other, and the launch no more threads than the list has places.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class Envs:
    """Environments of a launch for its kernel, whose first index is a place.

    mask: environments that take part, 0 or 1, [env_count].
    listed: environment of each place, [places]; without a list empty: place e is environment e.
    count: how many places have one, [1].
    """

    mask: wp.array(dtype=wp.int32)
    listed: wp.array(dtype=wp.int32)
    count: wp.array(dtype=wp.int32)


@wp.func
def env_at(place: int, envs: Envs) -> int:
    """Environment at a place of a launch that takes part, -1 for none."""
    env = place
    if envs.listed.shape[0] > 0:
        if place >= envs.count[0]:
            return -1
        env = envs.listed[place]
    if envs.mask[env] == 0:
        return -1
    return env


@wp.kernel
def _list_kernel(mask: wp.array(dtype=wp.int32), envs: Envs):
    env = wp.tid()
    if mask[env] != 0:
        at = wp.atomic_add(envs.count, 0, 1)
        if at < envs.listed.shape[0]:
            envs.listed[at] = env


class EnvList:
    """Places for the environments of a mask, in any order."""

    def __init__(self, places: int, device: wp.Device) -> None:
        self.listed = wp.zeros(places, dtype=wp.int32, device=device)
        self.count = wp.zeros(1, dtype=wp.int32, device=device)

    def fill(self, mask: wp.array) -> None:
        """List the environments of ``mask``, int32, [env_count]; no more than there are places."""
        self.count.zero_()
        wp.launch(_list_kernel, len(mask), [mask, ListedMask(mask, self).envs], device=mask.device)


class ListedMask:
    """A mask whose environments are all on a list; launches take it in place of the mask alone."""

    def __init__(self, mask: wp.array, places: EnvList | None = None) -> None:
        self.mask = mask
        """int32, [env_count]."""
        self.places = places
        self.device = mask.device
        self.envs = Envs()
        """Both for kernels."""
        self.envs.mask = mask
        if places is not None:
            self.envs.listed, self.envs.count = places.listed, places.count

    def __len__(self) -> int:
        return len(self.mask)

    def of(self, mask: wp.array) -> ListedMask:
        """Another mask of environments on the list."""
        return ListedMask(mask, self.places)


EnvMask = wp.array | ListedMask
"""Environments that something is done in."""


def place_count(active: EnvMask) -> int:
    """Places of a launch over these environments."""
    places = active.places if isinstance(active, ListedMask) else None
    return len(active if places is None else places.listed)


def mask_like(active: EnvMask, mask: wp.array) -> EnvMask:
    """A mask of environments that are among those of ``active``."""
    return active.of(mask) if isinstance(active, ListedMask) else mask
