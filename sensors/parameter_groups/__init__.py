# SPDX-License-Identifier: Apache-2.0
"""Parameters that most sensors share, one dataclass a part: image, camera, lights, window.

A family has them through ``taccel_lab.sensors.camera_sensor`` and restates what is special about it
(``taccel_lab.cad.parameters.restated``), with its source. The defaults here stand where no source
says anything about a sensor, and say so.
"""
