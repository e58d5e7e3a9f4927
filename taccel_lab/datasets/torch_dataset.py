# SPDX-License-Identifier: Apache-2.0
"""A data set for torch.

>>> from torch.utils.data import DataLoader                                # doctest: +SKIP
>>> touches = TouchDataset("out/touches", inputs=("rgb",), split="train")  # doctest: +SKIP
>>> for batch in DataLoader(touches, 64, shuffle=True, num_workers=4): ... # doctest: +SKIP
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch.utils.data import Dataset as TorchBase

from taccel_lab.datasets.reading import Dataset
from taccel_lab.guards import require_known

LABELS = ("wrench", "contact_area_mm2", "patch_forces_n")


class TouchDataset(TorchBase):
    """Steps as dictionaries of tensors: what is seen and its labels.

    ``rgb`` comes as float32 [3, height, width] from 0 to 1, numbers as float32. Each worker opens
    the files for itself.
    """

    def __init__(
        self,
        folders: str | Path | Sequence[str | Path],
        *,
        inputs: Sequence[str] = ("rgb",),
        labels: Sequence[str] = LABELS,
        split: str | None = None,
        background: bool = False,
    ) -> None:
        """
        Args:
            folders: One or several.
            inputs: Channels that are seen.
            labels: Channels of labels; those that a data set lacks are rejected.
            split: train or test alone.
            background: Give the untouched gel's image of the same episode, too, as ``rest_rgb``.
        """
        self.data = Dataset(folders, split=split)
        self.names = (*inputs, *labels)
        for name in self.names:
            require_known("channel", name, self.data.channels)
        self._rest = self._first_steps() if background else None

    def _first_steps(self) -> np.ndarray:
        """Step 0 of the episode of each step."""
        place = self.data.steps["place"]
        first = np.searchsorted(place, np.arange(len(self.data.episodes)))
        return first[place]

    def __len__(self) -> int:
        return len(self.data)

    def __getitem__(self, index: int) -> dict[str, torch.Tensor]:
        return self.__getitems__([index])[0]

    def __getitems__(self, indices: Sequence[int]) -> list[dict[str, torch.Tensor]]:
        """The items of a batch, which torch asks for at once: neighbours are read together."""
        found = {name: _tensor(name, self.data.read(name, indices)) for name in self.names}
        if self._rest is not None:
            found["rest_rgb"] = _tensor("rgb", self.data.read("rgb", self._rest[list(indices)]))
        return [{name: v[i] for name, v in found.items()} for i in range(len(indices))]


def _tensor(name: str, values: np.ndarray) -> torch.Tensor:
    if name == "rgb":
        return torch.from_numpy(values).permute(0, 3, 1, 2).float() / 255
    return torch.from_numpy(np.asarray(values, dtype=np.float32))
