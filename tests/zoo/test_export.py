"""Exported files give the policy's actions in other runtimes."""

import itertools
import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import safetensors.numpy

from population.networks.onnx_export import to_onnx
from population.networks.policy import Policy
from population.networks.spec import PolicySpec
from population.networks.torch_export import to_torch
from tests.zoo import numpy_torch

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")

ROOT = Path(__file__).parents[2]
ROWS, STEPS, TOLERANCE = 16, 5, 1e-5
SPECS = [
    PolicySpec("robot", 9, 4, torso, hidden, activation, squash, std, normalise)
    for (torso, hidden), activation, squash, std, normalise in itertools.product(
        (("mlp", (16, 8)), ("mlp", (12,)), ("gru", (16, 8)), ("gru", (8,))),
        ("tanh", "relu"),
        ("clip", "tanh"),
        ("parameter", "state"),
        (True, False),
    )
]
V0 = PolicySpec("robot", 34, 7)
LATENT = [
    PolicySpec("robot", 9, 4, hidden=(16, 8), squash=squash, normalise=normalise, latent=5)
    for squash, normalise in (("clip", True), ("tanh", False))
]
NAMES = [f"{s.torso}{len(s.hidden)}-{s.activation}-{s.squash}-{s.std}-{s.normalise}" for s in SPECS]


def trained(spec: PolicySpec, seed: int = 0) -> dict[str, Any]:
    """Return parameters with nothing at its initial value: no part can be left out unseen."""
    rng = np.random.default_rng(seed)

    def moved(leaf: jax.Array) -> np.ndarray:
        return (np.asarray(leaf) + 0.4 * rng.normal(size=leaf.shape)).astype(np.float32)

    params = jax.tree.map(moved, Policy(spec).init(jax.random.key(seed)))
    if spec.normalise:
        std = rng.uniform(0.1, 2.0, spec.observation_size)
        params["normaliser"]["std"] = std.astype(np.float32)
    return params


def observations(spec: PolicySpec) -> np.ndarray:
    """Return observations [T, N, O]."""
    rng = np.random.default_rng(1)
    obs = rng.normal(0.0, 2.0, (STEPS, ROWS, spec.observation_size)).astype(np.float32)
    obs[0, 0] = 1e4  # far beyond the normaliser's limit
    return obs


def episode(spec: PolicySpec, params: dict[str, Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return observations [T, N, O], first [T, N], actions [T, N, A]; some rows restart at 3."""
    obs = observations(spec)
    first = np.zeros((STEPS, ROWS), bool)
    first[0], first[3, ::2] = True, True
    policy = Policy(spec)
    carry, actions = policy.initial_carry((ROWS,)), []
    for step in range(STEPS):
        carry, action = policy.act(params, carry, jnp.asarray(obs[step]), jnp.asarray(first[step]))
        actions.append(np.asarray(action))
    return obs, first, np.stack(actions)


def play_onnx(data: bytes, obs: np.ndarray, first: np.ndarray) -> np.ndarray:
    session = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
    names = [value.name for value in session.get_inputs()]
    carry, actions = None, []
    for step in range(len(obs)):
        fed: dict[str, Any] = {"obs": obs[step]}
        if len(names) == 3:
            if carry is None:  # what `first` clears
                carry = np.full((ROWS, session.get_inputs()[1].shape[1]), np.float32(7.0))
            fed |= {"carry": carry, "first": first[step]}
        action, *rest = session.run(None, fed)
        carry = rest[0] if rest else None
        actions.append(action)
    return np.stack(actions)


@pytest.mark.parametrize(
    "spec", [*SPECS, V0, *LATENT], ids=[*NAMES, "v0", "latent-clip", "latent-tanh"]
)
def test_onnx_gives_the_same_actions(spec: PolicySpec) -> None:
    params = trained(spec)
    obs, first, expected = episode(spec, params)
    actions = play_onnx(to_onnx(spec, params), obs, first)
    assert actions.dtype == np.float32 and actions.shape == expected.shape
    assert np.abs(actions - expected).max() < TOLERANCE
    assert np.ptp(expected) > 0.5  # there was something to tell apart


def test_a_latent_is_no_form_of_torch() -> None:
    with pytest.raises(ValueError, match=r"latent of 5 numbers, .* export it as onnx"):
        to_torch(LATENT[0], trained(LATENT[0]))


@pytest.mark.parametrize(
    "leaf",
    ["normaliser/mean", "Dense_0/bias", "GRUCell_0/hn/bias", "GRUCell_0/iz/bias", "Dense_1/kernel"],
)
def test_a_changed_parameter_would_be_seen(leaf: str) -> None:
    """The comparison can fail, for every part of the network."""
    spec = PolicySpec("robot", 9, 4, "gru", (16, 8))
    params = trained(spec)
    obs, first, expected = episode(spec, params)
    *path, name = leaf.split("/")
    node = params
    for part in path:
        node = node[part]
    node[name] = node[name] + np.float32(0.01)
    assert np.abs(play_onnx(to_onnx(spec, params), obs, first) - expected).max() > TOLERANCE


def test_a_parameter_that_is_missing_is_named() -> None:
    params = trained(V0)
    del params["Dense_2"]
    for export in (to_onnx, to_torch):
        with pytest.raises(ValueError, match="Dense_2"):
            export(V0, params)


def test_onnx_files_are_described_and_stable() -> None:
    params = trained(V0)
    data = to_onnx(V0, params, {"id": "scratch/ippo-d1-s0-v0/robot"})
    assert data == to_onnx(V0, params, {"id": "scratch/ippo-d1-s0-v0/robot"})
    model = onnx.load_from_string(data)
    (kept,) = model.metadata_props
    assert json.loads(kept.value) == {"spec": V0.to_json(), "id": "scratch/ippo-d1-s0-v0/robot"}
    assert {part.domain for part in (*model.graph.node, *model.opset_import)} == {""}


def torch_or_stand_in() -> Any:
    """Return torch, its `safe_open` and its tensors, or their stand-ins if it is not installed."""
    try:
        import torch
    except ImportError:
        return numpy_torch
    return SimpleNamespace(torch=torch, safe_open=safetensors.safe_open, tensor=torch.from_numpy)


@pytest.mark.parametrize("spec", SPECS, ids=NAMES)
def test_documented_torch_module_gives_the_same_actions(tmp_path: Path, spec: PolicySpec) -> None:
    params, obs, library = trained(spec), observations(spec), torch_or_stand_in()
    page = (ROOT / "docs/export.md").read_text()
    (code,) = re.findall(r"## PyTorch\n\n```python\n(.*?)```", page, re.DOTALL)
    imports = "import json, torch\nfrom safetensors import safe_open\n"
    names: dict[str, Any] = {"json": json, "torch": library.torch, "safe_open": library.safe_open}
    exec(code.removeprefix(imports), names)
    path = tmp_path / "robot.safetensors"
    path.write_bytes(to_torch(spec, params))
    policy, module = Policy(spec), names["Policy"](str(path))
    ours, theirs = policy.initial_carry((ROWS,)), None
    for step in range(STEPS):
        ours, expected = policy.act(params, ours, jnp.asarray(obs[step]), jnp.zeros(ROWS, bool))
        with library.torch.no_grad():
            actual, theirs = module(library.tensor(obs[step]), theirs)
        np.testing.assert_allclose(np.asarray(actual), expected, atol=TOLERANCE)


def test_torch_files_keep_the_standard_deviation() -> None:
    for std, names in (("parameter", {"log_std"}), ("state", {"log_std.weight", "log_std.bias"})):
        spec = PolicySpec("robot", 9, 4, std=std)
        state = safetensors.numpy.load(to_torch(spec, trained(spec)))
        assert {name for name in state if name.startswith("log_std")} == names
        assert state["layers.0.weight"].shape == (128, 9)
