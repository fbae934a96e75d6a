"""What plays a policy, by its spec."""

from typing import Any

from evaluation.cast.baseline_policies import ReferencePolicy, ScriptedPolicy
from evaluation.cast.roster import ReferenceSpec, ScriptSpec
from population.networks.policy import Policy


def make_player(spec: Any) -> Any:
    """Return what plays policies of a spec, in the form of `population.networks.policy.Policy`."""
    if isinstance(spec, ReferenceSpec):
        return ReferencePolicy(spec)
    if isinstance(spec, ScriptSpec):
        return ScriptedPolicy(spec)
    if hasattr(spec, "make_policy"):  # a network that is not of this project, such as from ONNX
        return spec.make_policy()
    return Policy(spec)
