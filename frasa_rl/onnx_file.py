"""A plain policy as an ONNX file: Gemm, Relu, Tanh, built node by node, so that no trainer is needed."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from frasa_rl.runtime import Layers

# Read by onnxruntime since 1.10 and by OpenVINO since 2022; nothing later is needed for three kinds of nodes.
OPSET, IR_VERSION = 13, 8
INPUT, OUTPUT = "obs", "actions"  # as mjlab and rsl_rl call them


def onnx_bytes(layers: Layers, metadata: Mapping[str, str]) -> bytes:
    """The file's content: observations (batch, 22) in, actions (batch, 5) in [-1, 1] out.

    Args:
        layers: weights (out, in) and biases (out,).
        metadata: goes into `metadata_props`.

    Raises:
        ModuleNotFoundError: the package `onnx` is not installed.
    """
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    nodes, numbers = [], []
    name = INPUT
    for index, (weight, bias) in enumerate(layers):
        last = index == len(layers) - 1
        for part, values in (("weight", weight), ("bias", bias)):
            numbers.append(numpy_helper.from_array(np.ascontiguousarray(values), f"layer{index}.{part}"))
        inputs = [name, f"layer{index}.weight", f"layer{index}.bias"]
        nodes.append(helper.make_node("Gemm", inputs, [f"layer{index}.sum"], f"layer{index}", transB=1))
        name = OUTPUT if last else f"layer{index}.out"
        nodes.append(helper.make_node("Tanh" if last else "Relu", [f"layer{index}.sum"], [name], f"{name}.act"))

    def tensor(tensor_name: str, size: int) -> Any:  # noqa: ANN401 - a message of onnx, which has no types
        return helper.make_tensor_value_info(tensor_name, TensorProto.FLOAT, ["batch", size])

    sizes = layers[0][0].shape[1], layers[-1][0].shape[0]
    graph = helper.make_graph(nodes, "frasa", [tensor(INPUT, sizes[0])], [tensor(OUTPUT, sizes[1])], numbers)
    opset = [helper.make_opsetid("", OPSET)]
    model = helper.make_model(graph, producer_name="frasa", opset_imports=opset, ir_version=IR_VERSION)
    helper.set_model_props(model, dict(metadata))
    onnx.checker.check_model(model)
    content: bytes = model.SerializeToString()
    return content
