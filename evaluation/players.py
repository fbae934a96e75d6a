"""What plays a policy, by its spec."""

from typing import Any

from evaluation.reference_policy import ReferencePolicy, ScriptedPolicy
from evaluation.roster import ReferenceSpec, ScriptSpec
from population.policy import Policy


def make_player(spec: Any) -> Any:
    """Return what plays policies of a spec, in the interface of `population.policy.Policy`."""
    if isinstance(spec, ReferenceSpec):
        return ReferencePolicy(spec)
    if isinstance(spec, ScriptSpec):
        return ScriptedPolicy(spec)
    if hasattr(spec, "make_policy"):  # a network that is not of this project, such as from ONNX
        return spec.make_policy()
    return Policy(spec)
