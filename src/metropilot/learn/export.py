"""A policy as an ONNX graph, by hand, checked against the original and timed (extra ``onnx``)."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from metropilot._io import atomic_write
from metropilot.errors import InputError
from metropilot.policy import NORMALISED_RANGE, Policy, PolicySpec

OPSET = 17
IR_VERSION = 8
# Largest difference allowed between the graph and the policy, for actions or values of the order of one.
PARITY = 1e-5


@dataclass(frozen=True)
class ExportReport:
    """Report on an exported policy: its evaluation and its file.

    Attributes:
        path: The file.
        parity: Largest difference from the policy over the probes, relative to one or to the output's size.
        latency_us_median: Of one decision in onnxruntime, one thread, in microseconds.
        latency_us_p99: Its 99th percentile.
        bytes: Size of the file.
        probes: Observations compared.
    """

    path: Path
    parity: float
    latency_us_median: float
    latency_us_p99: float
    bytes: int
    probes: int


@dataclass
class _Graph:
    """A graph in the making: nodes and constants, in order."""

    onnx: Any
    nodes: list[Any] = field(default_factory=list)
    constants: dict[str, np.ndarray] = field(default_factory=dict)

    def add(self, kind: str, *inputs: str, **attributes: Any) -> str:
        """Add a node and return the name of its output."""
        name = attributes.pop("name", f"{kind.lower()}_{len(self.nodes)}")
        self.nodes.append(self.onnx.helper.make_node(kind, list(inputs), [name], **attributes))
        return name

    def constant(self, name: str, value: Any) -> str:
        """Add a constant and return its name."""
        self.constants[name] = np.asarray(value)
        return name


def export_onnx(
    policy: Policy, path: Path, *, about: Mapping[str, Any] | None = None, probes: int = 1_000
) -> ExportReport:
    """Write a policy as ONNX: input ``observation`` (N, O), output ``action``, (N, A) or (N,) for choices.

    Choices come with a second output ``values`` (N, count), so that a filter can choose again.

    Args:
        policy: Of one seed.
        path: File to write.
        about: Entries of the file's metadata: one JSON string each.
        probes: Random observations on which graph and policy are compared.

    Raises:
        InputError: The extra is not installed, the policy is a table, or the graph differs from the policy.
    """
    onnx, runtime = _libraries()
    if policy.spec.output == "table":
        raise InputError("a table has no ONNX graph", field="policy", value=policy.spec.output)
    model = build(onnx, policy)
    entries = {name: json.dumps(value, sort_keys=True) for name, value in (about or {}).items()}
    onnx.helper.set_model_props(model, entries)
    text = model.SerializeToString()
    options = runtime.SessionOptions()
    # One thread: that is what a driver has for one decision, and the latency below is measured with it.
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    session = runtime.InferenceSession(text, options, providers=["CPUExecutionProvider"])
    parity = _parity(policy, session, probes)
    if not parity < PARITY:
        raise InputError(
            "the graph differs from the policy", file=path, value=f"{parity:.1e}", allowed=f"{PARITY:.0e}"
        )
    atomic_write(path, lambda partial: partial.write_bytes(text))
    median, late = _latency(session, policy.spec.observation_size)
    return ExportReport(path, parity, median, late, len(text), probes)


def _libraries() -> tuple[Any, Any]:
    try:
        import onnx
        import onnx.helper
        import onnxruntime
    except ImportError as error:
        allowed = 'pip install "metropilot[onnx]"'
        raise InputError(
            "needs a package that is not installed", field="onnx", value=error.name, allowed=allowed
        ) from None
    return onnx, onnxruntime


def build(onnx: Any, policy: Policy) -> Any:
    """The ONNX model of a policy, checked by the library's own checker."""
    spec, graph, helper = policy.spec, _Graph(onnx), onnx.helper
    params = {name: np.asarray(value, np.float32) for name, value in policy.params.items()}
    for name, value in params.items():
        graph.constant(name, value)
    x = "observation"
    if spec.normalised:
        x = graph.add("Mul", graph.add("Sub", x, "observation.mean"), "observation.scale")
        x = _clip(graph, x, NORMALISED_RANGE)
    if spec.output == "dueling":
        x = _activate(graph, spec, _layers(graph, spec, x, "policy", params))
        value = _layers(graph, spec, x, "policy.value", params)
        advantage = _layers(graph, spec, x, "policy.advantage", params)
        mean = graph.add("ReduceMean", advantage, axes=[1], keepdims=1)
        x = graph.add("Add", value, graph.add("Sub", advantage, mean), name="values")
    else:
        x = _layers(graph, spec, x, "policy", params)
    outputs = list(_outputs(graph, spec, x))
    kinds = {"action": ([None] if spec.discrete else [None, spec.actions])}
    shapes = {"action": onnx.TensorProto.INT64 if spec.discrete else onnx.TensorProto.FLOAT}
    infos = [
        helper.make_tensor_value_info(
            name, shapes.get(name, onnx.TensorProto.FLOAT), kinds.get(name, [None, spec.actions])
        )
        for name in outputs
    ]
    given = helper.make_tensor_value_info(
        "observation", onnx.TensorProto.FLOAT, [None, spec.observation_size]
    )
    constants = [onnx.numpy_helper.from_array(value, name) for name, value in graph.constants.items()]
    body = helper.make_graph(graph.nodes, "policy", [given], infos, constants)
    opset = [helper.make_opsetid("", OPSET)]
    model = helper.make_model(body, opset_imports=opset, ir_version=IR_VERSION, producer_name="metropilot")
    onnx.checker.check_model(model, full_check=True)
    return model


def _layers(graph: _Graph, spec: PolicySpec, x: str, prefix: str, params: dict[str, np.ndarray]) -> str:
    """The layers ``prefix.0``, ``prefix.1``, ..., linear at the end."""
    k = 0
    while f"{prefix}.{k}.weight" in params:
        x = _activate(graph, spec, x) if k else x
        x = graph.add("Gemm", x, f"{prefix}.{k}.weight", f"{prefix}.{k}.bias")
        k += 1
    return x


def _activate(graph: _Graph, spec: PolicySpec, x: str) -> str:
    if spec.activation == "silu":
        return graph.add("Mul", x, graph.add("Sigmoid", x))
    return graph.add({"tanh": "Tanh", "relu": "Relu"}[spec.activation], x)


def _clip(graph: _Graph, x: str, bound: float, **attributes: Any) -> str:
    low = graph.constant(f"minus_{bound:g}", np.float32(-bound))
    return graph.add("Clip", x, low, graph.constant(f"plus_{bound:g}", np.float32(bound)), **attributes)


def _outputs(graph: _Graph, spec: PolicySpec, x: str) -> Iterator[str]:
    """The output nodes; their names."""
    if spec.discrete:
        values = x if x == "values" else graph.add("Identity", x, name="values")
        yield graph.add("ArgMax", values, axis=1, keepdims=0, name="action")
        yield values
        return
    if spec.width > spec.actions:
        ends = [graph.constant(f"slice_{k}", np.asarray([k], np.int64)) for k in (0, spec.actions, 1)]
        x = graph.add("Slice", x, *ends[:2], ends[2])
    yield (
        graph.add("Tanh", x, name="action") if spec.output == "tanh" else _clip(graph, x, 1.0, name="action")
    )


def _parity(policy: Policy, session: Any, probes: int) -> float:
    """Largest difference between graph and policy, one observation at a time and all together."""
    from metropilot.policy import network_output

    spec = policy.spec
    draws = np.random.default_rng(0).normal(0.0, 2.0, (probes, spec.observation_size)).astype(np.float32)
    if spec.discrete:
        expected = np.stack([network_output(spec, policy.params, x, np) for x in draws])
        found = session.run(["values"], {"observation": draws})[0]
    else:
        expected = np.stack([policy(x) for x in draws])
        found = session.run(["action"], {"observation": draws})[0]
    return float(np.max(np.abs(found - expected)) / max(1.0, float(np.max(np.abs(expected)))))


def _latency(session: Any, size: int) -> tuple[float, float]:
    """Median and 99th percentile of one decision, in microseconds."""
    observation = {"observation": np.zeros((1, size), np.float32)}
    spent = np.empty(2_000)
    for k in range(spent.size):
        start = time.perf_counter_ns()
        session.run(["action"], observation)
        spent[k] = (time.perf_counter_ns() - start) / 1e3
    return float(np.median(spent)), float(np.percentile(spent, 99))
