"""Figures: their content, their order, and no state left behind."""

import itertools
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text

from assistax_envs.disability import DISABILITY_SETTINGS
from evaluation.figures import saved_tables as derived
from evaluation.figures import summary
from evaluation.plots import style
from evaluation.plots.captions import provenance
from evaluation.plots.charts import (
    learning_curves,
    performance_profile,
    speed,
    trait_points,
    zsc_dots,
)
from evaluation.plots.crossplay.heatmap import crossplay_heatmap
from evaluation.plots.crossplay.matrix import Matrix, arrange, short_names
from evaluation.plots.crossplay.traits import traits_of
from evaluation.plots.population import population_grid
from evaluation.record import tables
from tests.evaluation.episode_tables import (
    CONTEXT,
    Team,
    clustered_matrix,
    episode_table,
    recorded,
    team_id,
    teams,
)
from tools.release_page.paper.panels import training_panels

ROOT = Path(__file__).parents[2]


def written(table: pl.DataFrame) -> tuple[pl.DataFrame, dict[str, Any]]:
    """Return the pairs and the summary that a cross-play writes."""
    content = tables.to_json(summary.summarise_crossplay(recorded(table), CONTEXT))
    return derived.pair_table(recorded(table)), content


def saved(population: list[Team], clusters: int = 3) -> tuple[pl.DataFrame, dict[str, Any]]:
    matrix = clustered_matrix(len(population), clusters)
    return written(episode_table(matrix[:, :, None], population, population))


def draw_robot(values: np.ndarray) -> tuple[Matrix, Figure]:
    """Draw returns of one robot from outside with as many partners."""
    partners = teams(len(values))
    pairs, figures = written(episode_table(values.reshape(1, -1, 1), ["my robot"], partners))
    return arrange(pairs), crossplay_heatmap(arrange(pairs), figures)


def draw(population: list[Team], how: Any = None, clusters: int = 3) -> tuple[Matrix, Figure]:
    pairs, figures = saved(population, clusters)
    matrix = arrange(pairs, how)
    return matrix, crossplay_heatmap(matrix, figures)


def axes_by_label(figure: Figure) -> dict[str, Any]:
    return {str(axes.get_label()): axes for axes in figure.axes}


def visible_texts(figure: Figure) -> list[Text]:
    return [text for text in figure.findobj(Text) if text.get_text() and text.get_visible()]


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in visible_texts(figure)]


@pytest.mark.parametrize("how", ["shared", "separate"])
def test_orders_keep_values_and_self_play(how: str):
    population = teams(12, ("ippo", "isac"), ("d1", "d9"))
    matrix, _ = draw(population, how)
    assert matrix.shared == (how == "shared") and matrix.self_play.sum() == 12
    if matrix.shared:
        np.testing.assert_array_equal(matrix.self_play, np.eye(12, dtype=bool))
        assert matrix.rows.teams == matrix.columns.teams
    names = [team_id(team) for team in population]
    sides = (matrix.rows, matrix.columns)
    places = ([names.index(str(team)) for team in side.teams] for side in sides)
    np.testing.assert_allclose(matrix.values, clustered_matrix(12, 3)[np.ix_(*places)], rtol=1e-6)


def test_heatmap_has_all_parts():
    population = teams(32, ("ippo",), ("d1", "d3", "d7", "d9"))
    matrix, figure = draw(population, clusters=4)
    parts = axes_by_label(figure)
    strips = (f"strip:{{}}:{name}" for name in ("algorithm", "range", "strength"))
    kinds = ("tree:{}", "clusters:{}", *strips)
    beside = {kind.format(seat) for kind in kinds for seat in ("ego", "partner")}
    assert set(parts) == {"matrix", "colourbar", "legend"} | beside
    assert parts["matrix"].get_xlabel() == "human (partner)"
    assert parts["tree:ego"].get_ylabel() == "robot (ego)"
    assert parts["colourbar"].get_ylabel() == "mean return of an episode"
    labels = [label.get_text() for label in parts["matrix"].get_yticklabels()]
    assert labels == list(matrix.rows.names)
    assert set(labels) == {f"{a}-{d}-s{s}" for a, d, s in population}
    caption = " ".join(texts(figure)).replace("\n", " ")
    for words in (
        "Cross-play: scratch",
        "n = 32 robots × 32 humans, 1 episode a pair (1,024 episodes, 0 non-finite)",
        "Release v0, split scratch-half-v0",
        "self-play on the diagonal",
        "0.4 (d7 d9)",
        "0.4 (d3 d9)",
        "n = 8, medoid ippo-d1",
    ):
        assert words in caption


def test_strips_follow_order_of_policies():
    matrix, figure = draw(teams(12, ("ippo", "isac"), ("d1", "d5", "d9")))
    parts = axes_by_label(figure)
    for seat, side, axis in (("ego", matrix.rows, 0), ("partner", matrix.columns, 1)):
        palette = style.algorithm_colours(side.algorithms)
        levels = [DISABILITY_SETTINGS[str(name)] for name in side.disabilities]
        for trait, colours in (
            ("algorithm", [palette[str(name)] for name in side.algorithms]),
            ("strength", [style.level_colour("strength", one.strength) for one in levels]),
            ("range", [style.level_colour("range", one.elbow_range) for one in levels]),
        ):
            shown = np.asarray(parts[f"strip:{seat}:{trait}"].images[0].get_array())
            assert shown.shape[axis] == 12
            expected = [to_rgb(colour) for colour in colours]
            np.testing.assert_allclose(shown.reshape(12, 3), expected)


def test_settings_without_meaning_are_shown_by_name_if_they_differ():
    several = traits_of(["ippo"], ["d1", "tremor-1", "tremor-2", None])
    assert [trait.name for trait in several] == ["strength", "range", "disability", "algorithm"]
    values = [[trait.value("ippo", name) for trait in several] for name in ("d1", "tremor-1", None)]
    assert values == [
        ["1 (d1)", "1 (d1)", None, "IPPO"],
        [None, None, "tremor-1", "IPPO"],
        [None, None, None, "IPPO"],
    ]
    assert [trait.name for trait in traits_of(["gru"], [None, "own", "own"])] == ["algorithm"]


def test_strips_and_dendrograms_are_aligned_with_the_matrix():
    _, figure = draw(teams(12))
    parts = axes_by_label(figure)
    heat = parts["matrix"].get_position()
    for name, axes in parts.items():
        box = axes.get_position()
        if ":ego" in name:
            assert (box.y0, box.y1) == pytest.approx((heat.y0, heat.y1))
            assert axes.get_ylim() == parts["matrix"].get_ylim()
            assert box.x1 < heat.x0
        if ":partner" in name:
            assert (box.x0, box.x1) == pytest.approx((heat.x0, heat.x1))
            assert axes.get_xlim() == parts["matrix"].get_xlim()
            assert box.y0 > heat.y1


@pytest.mark.parametrize(
    ("count", "how"),
    [(1, None), (2, None), (8, "separate"), (32, None), (80, "separate"), (80, "shared")],
)
def test_texts_are_inside_and_apart(count: int, how: Any):
    population = teams(
        count, ("ippo", "isac", "mappo", "masac"), tuple(f"d{i}" for i in range(1, 10))
    )
    _, figure = draw(population, how, clusters=min(4, count))
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    bar = axes_by_label(figure)["colourbar"]
    unseen = [
        label
        for label in bar.get_yticklabels()
        if not bar.get_ylim()[0] <= label.get_position()[1] <= bar.get_ylim()[1]
    ]
    boxes = [
        (text.get_text(), np.array(text.get_window_extent(renderer).extents))
        for text in visible_texts(figure)
        if text not in unseen
    ]
    size = figure.get_size_inches() * figure.dpi
    for words, box in boxes:
        assert np.all(box[:2] >= -1), words
        assert np.all(box[2:] <= size + 1), words
    for (a, (x0, y0, x1, y1)), (b, (u0, v0, u1, v1)) in itertools.combinations(boxes, 2):
        slack = 0.15 * min(y1 - y0, v1 - v0, x1 - x0, u1 - u0)  # a box is higher than its letters
        assert min(x1, u1) - max(x0, u0) <= slack or min(y1, v1) - max(y0, v0) <= slack, (a, b)


def test_a_large_matrix_names_clusters_instead_of_policies():
    _, figure = draw(teams(100))
    parts = axes_by_label(figure)
    assert list(parts["matrix"].get_xticks()) == []
    assert parts["matrix"].get_xlabel() == "human (partner), n = 100"
    assert {text.get_text() for text in parts["clusters:ego"].texts} == {"A", "B", "C"}


def test_small_matrix_shows_numbers():
    matrix, figure = draw(teams(4), clusters=2)
    shown = axes_by_label(figure)["matrix"].texts
    assert [text.get_text() for text in shown] == [
        f"{value:.0f}" for value in matrix.values.ravel()
    ]
    bold = np.array([text.get_weight() == "bold" for text in shown]).reshape(4, 4)
    np.testing.assert_array_equal(bold, np.eye(4, dtype=bool))


def test_rounded_zero_has_no_sign():
    _, figure = draw_robot(np.array([-0.3, 0.3, -12.4, 7.0]))
    shown = axes_by_label(figure)["matrix"].texts
    assert sorted(text.get_text() for text in shown) == ["-12", "0", "0", "7"]


@pytest.mark.parametrize(
    ("least", "message"), [(0.0, None), (-5000.0, "5% of pairs, down to -5,000,")]
)
def test_colours_ignore_few_bad_pairs(least: float, message: str | None):
    values = np.linspace(0.0, 500.0, 20)
    values[0] = least
    _, figure = draw_robot(values)
    [image] = axes_by_label(figure)["matrix"].images
    first = 0.0 if message is None else 0.95 * values[1] + 0.05 * least
    assert (image.norm.vmin, image.norm.vmax) == (pytest.approx(first), 500.0)
    assert message is None or any(message in text for text in texts(figure))


def test_an_outsider_is_drawn_without_self_play():
    matrix, figure = draw_robot(np.arange(20.0))
    assert not matrix.self_play.any()
    assert "from outside the zoo" in texts(figure)
    pairs, _ = written(episode_table(np.ones((1, 4, 1)), ["my robot"], teams(4)))
    with pytest.raises(ValueError, match="so they share no order; choose 'separate'"):
        arrange(pairs, "shared")


def test_planted_defect_missing_pair_is_caught():
    pairs, _ = saved(teams(4), 2)
    unknown = pl.when(pl.int_range(pl.len()) == 3).then(float("nan")).otherwise("return")
    for table in (pairs[:-1], pairs.with_columns(unknown.alias("return"))):
        with pytest.raises(ValueError, match="no return for some pairs, or none that is finite"):
            arrange(table)


@pytest.mark.parametrize("ending", ["png", "pdf", "svg"])
def test_equal_figures_give_equal_files(tmp_path: Path, ending: str):
    paths = [tmp_path / f"{name}.{ending}" for name in ("a", "b")]
    for path in paths:
        style.save_figure(draw(teams(4), clusters=2)[1], path)
    assert paths[0].read_bytes() == paths[1].read_bytes()
    begin = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}
    assert paths[0].read_bytes().startswith(begin[ending])
    assert len(list(tmp_path.iterdir())) == 2
    with pytest.raises(ValueError, match=r"x\.eps ends in '\.eps'; figures are written as \.png"):
        style.save_figure(Figure(), tmp_path / "x.eps")


def test_drawing_never_imports_pyplot():
    code = (
        "import sys\n"
        "from evaluation.plots import charts, population\n"
        "from evaluation.plots.crossplay import heatmap\n"
        "sys.exit('matplotlib.pyplot' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_short_names_drop_common_parts():
    same = ["scratch/ippo-d1-s0-v0/robot", "scratch/ippo-d1-s1-v0/robot"]
    assert short_names(same) == ("ippo-d1-s0", "ippo-d1-s1")
    releases = ["scratch/ippo-d1-s0-v0/robot", "scratch/ippo-d1-s0-v1/robot"]
    assert short_names(releases) == ("ippo-d1-s0-v0", "ippo-d1-s0-v1")
    both = ["lab:scratch/ippo-d1-s0-v0/robot", "scratch/ippo-d1-s0-v0/robot"]
    assert short_names(both) == ("lab:ippo-d1-s0", "ippo-d1-s0")
    assert short_names(["a/x/robot", "b/x/robot"]) == ("a/x/robot", "b/x/robot")
    (long,) = short_names(["python:some.package.of.mine:make_robot"])
    assert long == "...kage.of.mine:make_robot"


def evaluations() -> dict[str, dict[str, Any]]:
    rng = np.random.default_rng(0)
    partners, sides = teams(8, ("ippo",), ("d1", "d9")), ["test", "train", "train", "test"] * 2

    def summarised(name: str, egos: int) -> dict[str, Any]:
        returns = rng.normal(500, 50, (egos, 8, 2))
        table = episode_table(returns, [f"{name}{i}" for i in range(egos)], partners, sides)
        return tables.to_json(summary.summarise_evaluation(recorded(table), CONTEXT))

    return {"ppo": summarised("ppo", 3), "fcp": summarised("fcp", 1)}


def test_dots_show_mean_and_interval():
    summaries = evaluations()
    figure = zsc_dots(summaries)
    axes = axes_by_label(figure)["returns"]
    dots = sorted(line.get_ydata()[0] for line in axes.lines if len(line.get_ydata()) == 1)
    values = [figures[key] for figures in summaries.values() for key in ("m_test", "m_train")]
    assert dots == pytest.approx(sorted(value["mean"] for value in values))
    whiskers = sorted(tuple(line.get_ydata()) for line in axes.lines if len(line.get_ydata()) == 2)
    np.testing.assert_allclose(whiskers, sorted(tuple(value["mean_ci"]) for value in values))
    caption = " ".join("\n".join(texts(figure)).split())
    assert "PPO: 3 seeds × 4 train partners, 4 test partners × 2 episodes; scratch" in caption
    assert "95% interval for new partners and starts; 95% interval for new seeds" in caption


def test_dots_without_any_side_are_refused():
    summaries = {"ppo": evaluations()["ppo"] | dict.fromkeys(("m_test", "m_train"))}
    with pytest.raises(ValueError, match="groups of their test sides did not play"):
        zsc_dots(summaries)


@pytest.mark.parametrize("zero_action", [3.0, 990.0])
def test_axis_includes_robots_and_references(zero_action):
    summaries = evaluations()
    summaries["ppo"]["references"] = {"zero_action": {"mean": zero_action}, "script": None}
    axes = axes_by_label(zsc_dots(summaries, {"self-play": 510.0}))["returns"]
    ends = [end for figures in summaries.values() for end in (*figures["m_test"]["mean_ci"],)]
    low, high = axes.get_ylim()
    assert low < min([*ends, zero_action]) and max([*ends, zero_action]) < high
    legend = [text.get_text() for text in axes.get_legend().get_texts()]
    assert legend == ["training partners", "test partners"]
    named = {" ".join(text.get_text().split()): text for text in axes.texts}
    for name, value in (("self-play 510", 510.0), (f"zero action {zero_action:.0f}", zero_action)):
        assert named[name].xy == (axes.get_xlim()[1], value)  # right of the line's end


def test_references_are_per_method():
    summaries = evaluations()
    for name, script, zero in (("ppo", 300.0, 10.0), ("fcp", 420.0, 10.2)):
        summaries[name]["references"] = {"script": {"mean": script}, "zero_action": {"mean": zero}}
    axes = axes_by_label(zsc_dots(summaries))["returns"]
    lines = [part.tolist() for parts in axes.collections for part in parts.get_segments()]
    for place, height in ((0, 300.0), (1, 420.0), (0, 10.0), (1, 10.2)):
        assert [[place - 0.5, height], [place + 0.5, height]] in lines
    named = {" ".join(text.get_text().split()): text for text in axes.texts}
    assert named["script 300 to 420"].xy[1] == 420.0  # beside the last method
    assert named["zero action 10"].xy[1] == 10.2


def test_numbers_overlap_no_dot():
    summaries = evaluations()
    for figures in summaries.values():  # side by side, where a number is nearest to another's dot
        figures["m_train"] |= {"mean": figures["m_test"]["mean"]}
    figure = zsc_dots(summaries, width=2.2)
    FigureCanvasAgg(figure).draw()
    axes = axes_by_label(figure)["returns"]
    dots = [np.asarray(line.get_xydata())[0] for line in axes.lines if len(line.get_xydata()) == 1]
    numbers = [text.get_window_extent() for text in axes.texts if text.get_text().isdigit()]
    assert len(numbers) == len(dots) == 4
    for number, dot in itertools.product(numbers, axes.transData.transform(np.array(dots))):
        assert not number.contains(*dot)


def test_axis_zooms_to_near_references():
    summaries = evaluations()
    low, high = axes_by_label(zsc_dots(summaries, {"self-play": 510.0}))["returns"].get_ylim()
    sides = [figures[key] for figures in summaries.values() for key in ("m_test", "m_train")]
    ends = [end for side in sides for end in side["mean_ci"]]
    assert min(ends) - 40 < low < min(ends) and max(ends) < high < max(ends) + 40


def test_missing_side_has_no_dot_and_no_plural():
    summaries = evaluations()
    for figures in summaries.values():
        figures |= {"m_train": None, "gap": None}
    lines = axes_by_label(zsc_dots(summaries))["returns"].lines
    assert sum(len(line.get_ydata()) == 1 for line in lines) == 2
    summaries["fcp"] |= {"partners": {"train": 0, "test": 1}, "episodes_per_pair": 1}
    assert "1 seed × 1 test partner × 1 episode;" in provenance(summaries)


def test_disability_points_and_mixed_tasks():
    summaries = evaluations()
    axes = axes_by_label(trait_points(summaries))["returns"]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["d1", "d9"]
    summaries["fcp"]["task"] = "bed_bath"
    with pytest.raises(ValueError, match="several tasks, bed_bath, scratch"):
        trait_points(summaries)
    with pytest.raises(ValueError, match="nothing to draw"):
        zsc_dots({})


def test_lines_are_the_saved_tables():
    profile = pl.DataFrame(
        {"threshold": [0.0, 1.0], "share": [1.0, 0.0], "low": [None, None], "high": [None, None]}
    )
    figure = performance_profile({"ppo": profile}, task="scratch", caption="n")
    axes = axes_by_label(figure)["lines"]
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), [1.0, 0.0])
    assert not axes.collections  # no band without an interval
    curves = pl.DataFrame(
        {"disability": ["d1"], "steps": [1e6], "iqm": [5.0], "low": [4.0], "high": [6.0]}
    )
    axes = axes_by_label(learning_curves(curves, title="t", caption="n"))["lines"]
    assert len(axes.collections) == 1
    assert [(text.get_text(), text.xy) for text in axes.texts] == [("d1", (1e6, 5.0))]


LONG = "IQM of the training return over seeds and its 95% interval. " * 4


def training(tasks: int) -> Figure:
    columns = {"algorithm": "ippo", "steps": 1e6, "iqm": 5.0, "low": 4.0, "high": 6.0}
    return training_panels(
        pl.DataFrame([{"task": f"task {i}"} | columns for i in range(tasks)]), {}, caption=LONG
    )


def speeds() -> Figure:
    columns = ["task", "backend", "device", "batch", "env_steps_per_second"]
    return speed(
        pl.DataFrame([("scratch", "native", "cpu", 64, 1e4)], schema=columns, orient="row"),
        caption=LONG,
    )


def bars(draw: Callable[[dict], Figure]) -> Figure:
    split = {"id": "scratch/half-s0-v1-524fe016", "sha256": "0"}
    return draw({"ppo": {**evaluations()["ppo"], "split": split}})


@pytest.mark.parametrize(
    "draw",
    [
        *(partial(training, tasks) for tasks in (1, 2, 3)),
        speeds,
        partial(bars, zsc_dots),
        partial(bars, trait_points),
    ],
)
def test_caption_fits_figure(draw: Callable[[], Figure]):
    figure = draw()
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    _, caption = (text.get_window_extent(canvas.get_renderer()) for text in figure.texts)
    ticks = figure.axes[0].xaxis.get_tightbbox(canvas.get_renderer())
    assert caption.x0 > 0 and caption.x1 < figure.get_size_inches()[0] * figure.dpi
    assert ticks is not None and 0 < caption.y0 < caption.y1 < ticks.y0


def test_grid_counts_partners():
    columns = ["task", "algorithm", "disability"]
    rows = [("scratch", "ippo", "d1")] * 6 + [("scratch", "ippo", "d9")] * 3
    rows += [("bed_bath", "isac", "d1")] * 2
    figure = population_grid(pl.DataFrame(rows, schema=columns, orient="row"), caption="n")
    scratch = axes_by_label(figure)["population:scratch"]
    cells = {text.get_position(): text.get_text() for text in scratch.texts}
    assert cells[(0.47, 0.46)] == "6" and cells[(8.47, 0.46)] == "3"
    assert cells[(9.47, 0.46)] == "9" and cells[(9.47, 1.46)] == "0"  # sums of ippo and isac
    assert (1.47, 0.46) not in cells  # nobody
    coloured = [to_hex(patch.get_facecolor()) for patch in scratch.patches]
    settings = style.disability_colours(["d1", "d9"])
    assert coloured[0] == settings["d1"] and coloured[8] == settings["d9"]
    with pytest.raises(ValueError, match="the population is empty"):
        population_grid(pl.DataFrame(schema=columns), caption="n")


def test_speeds_and_names_are_inside_figure():
    columns = ["task", "backend", "device", "batch", "env_steps_per_second"]
    rows = [
        (task, backend, "NVIDIA H200", 2**n, 90.0 * 4**n)
        for task in ("scratch", "bed_bath", "arm_assist")
        for backend in ("fused", "mjx-warp", "native")
        for n in range(1, 9)
    ]
    figure = speed(pl.DataFrame(rows, schema=columns, orient="row"), caption=LONG)
    axes = axes_by_label(figure)["lines"]
    low, high = axes.get_ylim()
    assert all(low <= y <= high for line in axes.lines for y in line.get_ydata())
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.canvas.draw()
    words = [text.get_window_extent(renderer) for text in axes.texts]
    assert len(words) == 3  # a name for each engine, at the end of its lines
    legend = axes.get_legend().get_window_extent(renderer)
    assert legend.y0 >= axes.get_window_extent().y1 - 1
    width, _ = figure.get_size_inches() * figure.dpi
    assert all(box.x0 > 0 and box.x1 < width for box in (legend, *words))
    assert legend.y1 < figure.texts[0].get_window_extent(renderer).y0  # below the title


def text_sizes(figure: Figure) -> dict[str, float]:
    return {text.get_text(): float(text.get_fontsize()) for text in visible_texts(figure)}


SETTINGS = tuple(f"d{i}" for i in range(1, 10))


@pytest.mark.parametrize("legend", [None, "beside", "below", "none"])
@pytest.mark.parametrize("width", [3.3, 6.75])
def test_matrix_has_given_width(tmp_path: Path, width: float, legend: Any):
    pairs, figures = saved(teams(118, ("ippo", "mappo", "masac", "mep"), SETTINGS), clusters=3)
    if (width, legend) == (3.3, "beside"):
        with pytest.raises(
            ValueError, match=r"width is 3.3 inches; allowed for this figure are 3.\d"
        ):
            crossplay_heatmap(arrange(pairs), figures, width=width, legend=legend)
        return
    figure = crossplay_heatmap(arrange(pairs), figures, width=width, legend=legend)
    assert figure.get_size_inches()[0] == width
    assert min(text_sizes(figure).values()) >= 4.0
    words = [text.get_text() for text in figure.texts]
    for bare, name in ((False, "whole.svg"), (True, "bare.svg")):
        content = style.save_figure(figure, tmp_path / name, bare=bare).get_size_inches()
        text = (tmp_path / name).read_text(encoding="utf-8")
        assert content[0] == width and f'width="{width * 72:g}pt"' in text
        # Letters, not outlines of letters.
        assert (">IPPO</text>" in text or ">IPPO<" in text) == (legend != "none")
        assert all((word.split("\n")[0][:20] in text) != bare for word in words)


def test_matrix_takes_most_of_a_column():
    pairs, figures = saved(teams(118, ("ippo", "masac"), SETTINGS), clusters=3)
    figure = crossplay_heatmap(arrange(pairs), figures, width=3.3)
    parts = axes_by_label(figure)
    assert parts["matrix"].get_position().width > 0.7
    legend = parts["legend"].get_window_extent().height / figure.dpi
    assert legend < 0.15 * figure.get_size_inches()[1]
    caption = " ".join(style.words(figure).split())
    assert (
        "Left out, as smaller than 4 points: names of 118 robots, names of 118 humans." in caption
    )
    without = crossplay_heatmap(arrange(pairs), figures, width=3.3, legend="none")
    assert "legend" not in axes_by_label(without)
    assert "Strips from the matrix outwards: strength, range, algorithm" in style.words(without)


@pytest.mark.parametrize(("count", "seen"), [(6, True), (14, False)])
def test_numbers_of_cells_are_left_out_where_too_small(count: int, seen: bool):
    values = np.full((count, count, 1), -123456.0) + 10 * np.eye(count)[:, :, None]
    population = teams(count)
    pairs, figures = written(episode_table(values, population, population))
    figure = crossplay_heatmap(arrange(pairs), figures, width=3.3)
    numbers = axes_by_label(figure)["matrix"].texts
    assert bool(numbers) == seen and min(text_sizes(figure).values()) >= 4.0
    assert ("numbers in cells" in style.words(figure)) != seen
    assert ("marked by dots" in style.words(figure)) != seen


def test_too_small_width_is_refused():
    pairs, figures = saved(teams(8))
    with pytest.raises(ValueError, match=r"width is 1 inches; allowed for this figure are \d"):
        crossplay_heatmap(arrange(pairs), figures, width=1.0)
    with pytest.raises(ValueError, match="width is 1 inches"):
        zsc_dots(evaluations(), width=1.0)
