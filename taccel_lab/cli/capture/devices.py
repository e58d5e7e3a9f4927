# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab capture devices``: cameras that are plugged in."""

from __future__ import annotations

from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class CaptureDevices:
    """List the cameras that are plugged in, by the id that capture record and live take.

    Ids stay with the camera: maker, model and serial number (GelSight Mini and DIGIT have one).
    """

    json: bool = False
    """Print the list as JSON."""

    def run(self) -> None:
        from rich.table import Table

        from taccel_lab.calibration.capture.camera.uvc import list_devices
        from taccel_lab.cli.console import print_json, results

        devices = list_devices()
        if self.json:
            print_json({"cameras": [asdict(device) for device in devices]})
            return
        console = results()
        if not devices:
            console.print("no camera is plugged in")
            return
        table = Table("--camera", "name", "serial", "node")
        for device in devices:
            table.add_row(device.id, device.name, device.serial or "-", device.node)
        console.print(table)
