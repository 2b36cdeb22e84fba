"""ONNX graphs: the same actions as the policy, fast, and small."""

import numpy as np
import pytest

from metropilot.errors import InputError
from metropilot.learn import export_onnx
from metropilot.policy import Policy, PolicySpec

pytest.importorskip("onnx")
runtime = pytest.importorskip("onnxruntime")

SPECS = {
    "ppo": PolicySpec("clip", 5, 2, (64, 64), "tanh", 2, normalised=True),
    "sac": PolicySpec("tanh", 5, 2, (32,), "relu", 4, normalised=True),
    "ddpg": PolicySpec("tanh", 5, 1, (32, 16), "silu", 1),
    "dqn": PolicySpec("argmax", 4, 12, (128, 256), "relu", 12),
    "dueling": PolicySpec("dueling", 4, 12, (128, 256), "relu", 12, normalised=True),
    "linear": PolicySpec("clip", 3, 1, (), "tanh", 1),
}


def policy(spec, seed=0):
    rng = np.random.default_rng(seed)
    params = {
        name: (rng.normal(size=shape) / max(1, shape[0]) ** 0.5).astype(np.float32)
        for name, shape in spec.shapes().items()
    }
    return Policy(spec, params)


@pytest.mark.parametrize("name", SPECS)
def test_graph_and_policy_agree(name, tmp_path):
    made = policy(SPECS[name])
    path = tmp_path / "driver.onnx"
    report = export_onnx(made, path, probes=200)
    assert report.parity < 1e-5
    assert report.bytes == path.stat().st_size
    # Generous on a busy machine; the benchmark states the number.
    assert report.latency_us_median < 500.0
    session = runtime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    x = np.random.default_rng(1).normal(size=(50, made.spec.observation_size)).astype(np.float32)
    actions = session.run(["action"], {"observation": x})[0]
    np.testing.assert_allclose(actions, np.stack([made(row) for row in x]), atol=1e-5)


def test_what_has_no_graph_is_refused(tmp_path):
    table = policy(PolicySpec("table", 1, 2, (3,), "tanh", 2))
    with pytest.raises(InputError, match="a table has no ONNX graph"):
        export_onnx(table, tmp_path / "t.onnx")
    assert not (tmp_path / "t.onnx").exists()
