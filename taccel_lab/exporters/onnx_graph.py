# SPDX-License-Identifier: Apache-2.0
"""An ONNX graph in the making."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import onnx

OPSET = 17
IR_VERSION = 8
"""The file version of opset 17."""


class Graph:
    """Nodes and constants of a graph in the making."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, value: np.ndarray | float, dtype: type = np.float32) -> str:
        from onnx import numpy_helper

        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.asarray(value, dtype=dtype), name))
        return name

    def add(self, kind: str, *inputs: str, output: str = "", **attributes: Any) -> str:
        from onnx import helper

        output = output or f"n{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, list(inputs), [output], **attributes))
        return output

    def activation(self, kind: str, x: str) -> str:
        if kind == "silu":
            return self.add("Mul", x, self.add("Sigmoid", x))
        return self.add({"tanh": "Tanh", "relu": "Relu"}[kind], x)

    def model(
        self, name: str, inputs: dict[str, list], outputs: dict[str, list]
    ) -> onnx.ModelProto:
        import onnx
        from onnx import TensorProto, helper

        def values(shapes: dict[str, list]) -> list[Any]:
            return [
                helper.make_tensor_value_info(key, TensorProto.FLOAT, shape)
                for key, shape in shapes.items()
            ]

        graph = helper.make_graph(self.nodes, name, values(inputs), values(outputs), self.constants)
        model = helper.make_model(
            graph,
            opset_imports=[helper.make_opsetid("", OPSET)],
            producer_name="taccel-lab",
            ir_version=IR_VERSION,
        )
        onnx.checker.check_model(model, full_check=True)
        return model
