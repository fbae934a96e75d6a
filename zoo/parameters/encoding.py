"""Shards as they are written: parameters that fit their spec, stacked, with a hash of each row."""

import functools
from collections.abc import Sequence

import numpy as np

from assistax_base.errors import FormatError
from population.networks.spec import PolicySpec
from population.networks.tensors import Leaves, encode, row_sha256


def encode_shard(
    spec: PolicySpec, policies: Sequence[tuple[str, Leaves]]
) -> tuple[bytes, list[str]]:
    """Return a shard's bytes and its rows' sha256, for (policy id, leaves) in row order.

    Raises:
        FormatError: The policies' leaves differ in name, shape or dtype.
    """
    forms = [
        {name: (value.shape, value.dtype.name) for name, value in leaves.items()}
        for _, leaves in policies
    ]
    for (policy, _), form in zip(policies, forms, strict=True):
        if form != forms[0]:
            odd = next(
                name for name in {**forms[0], **form} if form.get(name) != forms[0].get(name)
            )
            expected = f"{odd} {forms[0].get(odd)} as in {policies[0][0]}"
            raise FormatError(f"parameters of {policy}", expected, f"{odd} {form.get(odd)}")
    hashes = [row_sha256(leaves) for _, leaves in policies]
    rows = [
        {"id": policy, "sha256": digest}
        for (policy, _), digest in zip(policies, hashes, strict=True)
    ]
    stacked = {name: np.stack([leaves[name] for _, leaves in policies]) for name in forms[0]}
    return encode(stacked, {"spec": spec.to_json(), "rows": rows}), hashes


def check_params(spec: PolicySpec, leaves: Leaves, source: str) -> None:
    """Check that leaves (without the stacked axis) are those that `Policy(spec)` has; imports JAX.

    Raises:
        FormatError: A leaf is missing, unknown, or of another shape.
    """
    expected = _expected_shapes(spec)
    shapes = {name: tuple(value.shape) for name, value in leaves.items()}
    if shapes != expected:
        odd = next(
            name for name in {**expected, **shapes} if shapes.get(name) != expected.get(name)
        )
        raise FormatError(
            source, f"{odd} of shape {expected.get(odd)} for its spec", f"shape {shapes.get(odd)}"
        )


@functools.lru_cache
def _expected_shapes(spec: PolicySpec) -> dict[str, tuple[int, ...]]:
    import jax

    from assistax_envs.own_settings import key_of, own_settings
    from population.networks.policy import Policy

    with own_settings():
        tree = jax.eval_shape(Policy(spec).init, key_of(0))
    paths = jax.tree_util.tree_flatten_with_path(tree)[0]
    return {"/".join(key.key for key in path): tuple(leaf.shape) for path, leaf in paths}
