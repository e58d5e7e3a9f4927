# SPDX-License-Identifier: Apache-2.0
"""How many kernels a step launches from the host: what an eager step pays on a GPU."""

from __future__ import annotations

from typing import Any

import warp as wp


class LaunchCounter:
    """Counts ``wp.launch`` and its kin within its context; kernels inside a captured graph count
    as the one launch that they are for the host."""

    _NAMES = ("launch", "launch_tiled", "capture_launch")

    def __init__(self) -> None:
        self.count = 0
        self.kernels: set[str] = set()
        """Names of the kernels launched, with their modules."""

    def __enter__(self) -> LaunchCounter:
        self._real = {name: getattr(wp, name) for name in self._NAMES}
        self._recorded = wp.Launch.launch
        for name, function in self._real.items():
            setattr(wp, name, self._counted(function))
        counter, recorded = self, self._recorded

        def launch(command: wp.Launch, *arguments: Any, **options: Any) -> Any:
            counter._add(command.kernel)
            return recorded(command, *arguments, **options)

        wp.Launch.launch = launch  # type: ignore[method-assign]
        return self

    def __exit__(self, *error: Any) -> None:
        for name, function in self._real.items():
            setattr(wp, name, function)
        wp.Launch.launch = self._recorded  # type: ignore[method-assign]

    def _counted(self, function: Any) -> Any:
        def call(first: Any = None, *arguments: Any, **options: Any) -> Any:
            if not options.get("record_cmd"):
                self._add(options.get("kernel", first))
            if first is None:
                return function(*arguments, **options)
            return function(first, *arguments, **options)

        return call

    def _add(self, kernel: Any) -> None:
        self.count += 1
        module = getattr(getattr(kernel, "module", None), "name", "")
        self.kernels.add(f"{module}.{getattr(kernel, 'key', type(kernel).__name__)}")
