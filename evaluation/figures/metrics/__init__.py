"""Metrics of zero-shot coordination: functions of scores [S, P], [R, C] and returns [S, P, K]."""

from evaluation.figures.metrics.bounds import (
    Bounds,
    Coverage,
    br_prox,
    coverage,
    normalised_return,
    regret,
)
from evaluation.figures.metrics.comparison import (
    Agreement,
    Difference,
    Stability,
    paired_difference,
    rank_agreement,
    rank_stability,
)
from evaluation.figures.metrics.crossplay import CrossPlay, Traits, cross_play, same_teams
from evaluation.figures.metrics.generalisation import (
    Fairness,
    WorstPartner,
    ZeroShot,
    cvar_crossfit,
    estimate_of,
    fairness,
    group_draws,
    group_weights,
    mean_of_groups,
    worst_partner,
    zero_shot,
)
from evaluation.figures.metrics.ranks import SEED_SDS, Ranks, rank_methods

__all__ = [
    "SEED_SDS",
    "Agreement",
    "Bounds",
    "Coverage",
    "CrossPlay",
    "Difference",
    "Fairness",
    "Ranks",
    "Stability",
    "Traits",
    "WorstPartner",
    "ZeroShot",
    "br_prox",
    "coverage",
    "cross_play",
    "cvar_crossfit",
    "estimate_of",
    "fairness",
    "group_draws",
    "group_weights",
    "mean_of_groups",
    "normalised_return",
    "paired_difference",
    "rank_agreement",
    "rank_methods",
    "rank_stability",
    "regret",
    "same_teams",
    "worst_partner",
    "zero_shot",
]
