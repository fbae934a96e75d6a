"""Partners for zero-shot coordination in assistive robotics, and the evaluation of robots.

    import assistax_zoo as az

    partner = az.open_zoo().partner("scratch/ippo-d1-s0-v1")
    result = az.evaluate(my_robot, task="scratch", episodes=8)
    print(result.m_test)

Names are loaded when they are first used: importing this package costs nothing.
"""

import importlib
import importlib.util
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from assistax_workshop.auditing import audit
    from assistax_zoo.comparing import Comparison, compare, compare_named
    from assistax_zoo.evaluating import cross_play, evaluate
    from assistax_zoo.films import render
    from assistax_zoo.recording import trajectories
    from assistax_zoo.results import CrossPlayResult, EvaluationResult, load_result
    from assistax_zoo.training import train, train_ego
    from assistax_zoo.vector_envs import vector_env
    from assistax_zoo.zoos import Zoo, fetch, open_zoo
    from evaluation.cast.partners import Partner
    from evaluation.figures.metrics.variance import measure_spread
    from evaluation.figures.planning import measure_contrast, plan_contrast, plan_evaluation

__all__ = [
    "Comparison",
    "CrossPlayResult",
    "EvaluationResult",
    "Partner",
    "Zoo",
    "audit",
    "compare",
    "compare_named",
    "cross_play",
    "evaluate",
    "fetch",
    "load_result",
    "measure_contrast",
    "measure_spread",
    "open_zoo",
    "plan_contrast",
    "plan_evaluation",
    "render",
    "train",
    "train_ego",
    "trajectories",
    "vector_env",
]

_HOMES = {
    "evaluation.cast.partners": ("Partner",),
    "evaluation.figures.metrics.variance": ("measure_spread",),
    "evaluation.figures.planning": ("measure_contrast", "plan_contrast", "plan_evaluation"),
    "assistax_zoo.zoos": ("Zoo", "fetch", "open_zoo"),
    "assistax_zoo.comparing": ("Comparison", "compare", "compare_named"),
    "assistax_zoo.evaluating": ("cross_play", "evaluate"),
    "assistax_zoo.results": ("CrossPlayResult", "EvaluationResult", "load_result"),
    "assistax_workshop.auditing": ("audit",),
    "assistax_zoo.films": ("render",),
    "assistax_zoo.recording": ("trajectories",),
    "assistax_zoo.training": ("train", "train_ego"),
    "assistax_zoo.vector_envs": ("vector_env",),
}

_WORKSHOP = "assistax_workshop"


def __getattr__(name: str) -> Any:
    """Load a name's module when the name is first used."""
    for home, names in _HOMES.items():
        if name in names:
            from assistax_zoo.name_collisions import refuse_shadows

            refuse_shadows()
            if home.startswith(_WORKSHOP) and not importlib.util.find_spec(_WORKSHOP):
                raise ImportError(
                    f"{name} is part of assistax-zoo-workshop, which is not installed; install it "
                    "in a clone of assistax-zoo with: pip install -e . -e ./workshop"
                )
            return getattr(importlib.import_module(home), name)
    offered = ", ".join(__all__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it offers {offered}")


def __dir__() -> list[str]:
    return __all__
