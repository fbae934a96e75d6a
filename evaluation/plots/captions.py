"""Captions of figures, with the evaluations that the figures are made from."""

from collections.abc import Mapping
from typing import Any

from assistax_base.errors import counted
from evaluation.cast.met_partners import UNKNOWN
from evaluation.plots import style

Summaries = Mapping[str, Mapping[str, Any]]  # what `evaluate` saved, by the method's name


def provenance(summaries: Summaries) -> str:
    """Return a caption with a figure's numbers of robots, partners and episodes, and release.

    It says if the robots' training partners are unknown.
    """
    lines = []
    for name, summary in summaries.items():
        partners = ", ".join(
            counted(n, f"{side} partner") for side, n in summary["partners"].items() if n
        )
        split = f", split {summary['split']['id']}" if summary["split"] else ""
        broken = f", {summary['nonfinite']} episodes non-finite" if summary["nonfinite"] else ""
        known = (summary.get("met") or {}).get("known")
        lines.append(
            f"{style.spelled(name)}: {counted(len(summary['egos']), 'seed')} × {partners} "
            f"× {counted(summary['episodes_per_pair'], 'episode')}"
            f"{broken}; {summary['task']}, release {summary['release']}{split}, "
            f"{summary['backend']}{'' if known else f'; {UNKNOWN}'}"
        )
    return "\n".join(lines)
