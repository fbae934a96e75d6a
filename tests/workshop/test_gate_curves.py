"""The figure of how the gentle tasks' teams learned."""

from pathlib import Path

import polars as pl
import pytest

from assistax_workshop.gates.curves import draw_curves
from evaluation.plots import style


def test_curves_of_d1_are_drawn_of_the_algorithms_that_are_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    rows = [
        {
            "task": "gentle_bath", "algorithm": "mappo", "disability": setting, "seed": seed,
            "steps": 100 * point, "return": scale * point, "success": 0.25, "violated": 0.5,
            "term_force": -3.0,
        }
        for setting, scale in (("d1", 1.0), ("d2", 1000.0))
        for seed in range(3)
        for point in range(1, 6)
    ]  # fmt: skip
    curves = tmp_path / "curves"
    curves.mkdir()
    pl.DataFrame(rows).write_parquet(curves / "gentle-bath-mappo.parquet")
    drawn, band = [], style.band

    def watched(axes, curve, x, y, colour, label, *more):
        drawn.append((label, curve[y].to_list()))
        return band(axes, curve, x, y, colour, label, *more)

    monkeypatch.setattr(style, "band", watched)
    draw_curves(curves, tmp_path / "figure.png")
    assert drawn == [
        ("MAPPO", [1.0, 2.0, 3.0, 4.0, 5.0]),
        ("MAPPO", [0.25] * 5),
        ("MAPPO", [0.5] * 5),
        ("MAPPO", [3.0] * 5),
    ]
    assert (tmp_path / "figure.png").stat().st_size > 5000
