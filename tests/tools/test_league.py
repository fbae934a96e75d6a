"""Rows of the league from nothing, at tiny sizes, and the tables of its page."""

import dataclasses
import json
import sys
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from polars.testing import assert_frame_equal

from assistax_workshop.press.publish import publish
from evaluation.figures.league import read_league, row_folders
from evaluation.figures.summary import EvaluationSummary, read_summary
from evaluation.record.record import Record
from evaluation.validation import CHOICES
from population.method_presets import METHODS
from tests import untrained
from tests.evaluation.test_contrasts import NAMED
from tests.evaluation.test_league import put, put_beside_teams
from tools.league.__main__ import run
from tools.league.parts import teachers
from tools.league.queue import read_queue, run_queue
from tools.league.results import ShownContrast, sentences
from tools.league.rows import named, rows
from tools.league.tables import read_tables
from zoo.parameters.storage import read_policy_file
from zoo.partners.person_ids import is_team
from zoo.partners.person_tables import person_splits
from zoo.registry import load_registry
from zoo.splitting.create import create_split

TINY = ["--set", "num_envs=60", "--set", "rollout_steps=4", "--set", "minibatches=1"]
TINY += ["--set", "hidden=(8, 8)", "--steps", "480", "--episodes", "2", "--backend", "native"]
TINY += ["--checkpoints", "2", "--best-of", "2", "--sampled", "2"]


def test_rows_are_methods_and_bounds(capsys) -> None:
    known = list(rows())
    assert {"ppo", "sac", *METHODS, "told-gru", "told-partner"} <= set(known)
    assert known[:3] == ["best-fixed", "ppo", "ppo-best-of-4"]
    assert known[-2:] == ["best-response", "told-best-response"]
    assert run(["rows"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == known


def test_registered_method_is_a_row(monkeypatch) -> None:
    monkeypatch.setitem(METHODS, "new", ("", {}))
    made = named("new")
    assert (made.algorithm, made.source, made.told) == ("new", "train", False)


def test_students_imitate_the_best_quarter_of_their_teachers(tmp_path: Path) -> None:
    row, run = named("dagger"), tmp_path / "training"
    with pytest.raises(ValueError, match=r"imitates robots of told-gru, and .* has none"):
        teachers(tmp_path, row)
    run.mkdir()
    means = (3.0, 9.0, 1.0, 7.0, 8.0)
    by_seed = [{"seed": n, "mean": mean, "file": f"{n}"} for n, mean in enumerate(means)]
    (run / CHOICES).write_text(json.dumps({"by_seed": by_seed}))
    assert teachers(tmp_path, row) == [run / "1", run / "4"]


def test_a_stage_is_told_with_its_place() -> None:
    """Counters begin anew in each stage."""
    known = rows()
    assert known["gru"].stage("validation") == "stage 2 of 3, validation of gru"
    assert known["best-fixed"].stage("validation") == "stage 1 of 2, validation of best-fixed"
    assert known["best-response"].stage("evaluation") == "stage 2 of 2, evaluation of best-response"


PERSONS = "gentle_lift --split persons --part"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("row dreamer scratch", "row is 'dreamer'; allowed are best-fixed, ppo"),
        ("row ppo swim", "task is 'swim'"),
        ("row ppo scratch --split half", "has no validation side"),
        ("row ppo scratch --part 5/4", "part is '5/4'; give its number and of how"),
        (f"row gru {PERSONS} all/2", "lacks part-1-of-2, part-2-of-2; make"),
        (f"row mirror {PERSONS} 1/2", "part is 1/2 for row 'mirror'; allowed"),
        (f"row mirror {PERSONS} all/2", "'mirror' is not trained in parts"),
        (
            "row ppo gentle_scratch --split persons --side train",
            "only best responses are of another side",
        ),
    ],
)
def test_what_cannot_be_made_gets_one_line(words, message, tmp_path, capsys) -> None:
    assert run([*words.split(), "--out", str(tmp_path / "league")]) == 1
    assert message in capsys.readouterr().err
    assert not (tmp_path / "league").exists()


def test_a_page_without_rows_is_refused(tmp_path: Path, capsys) -> None:
    assert run(["page", str(tmp_path)]) == 1
    assert "no folder of a task with rows" in capsys.readouterr().err


@pytest.fixture(scope="module")
def registry(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twenty untrained teams, and a split of three sides: 12, 3 and 5."""
    path = untrained.published(untrained.teams_of(10), tmp_path_factory.mktemp("zoo"))
    with pytest.MonkeyPatch.context() as patch:  # humans that nobody trained act alike
        patch.setattr("zoo.splitting.create.similar_pairs", lambda registry, split: [])
        create_split(path, task="scratch", rule="three-sides", default=True)
    return path


@pytest.mark.slow
def test_rows_from_nothing_and_their_page(
    registry: Path, tmp_path: Path, capfd, monkeypatch
) -> None:
    monkeypatch.setattr("assistax_envs.env.EPISODE_LENGTH", 20)
    monkeypatch.setenv("ASSISTAX_ZOO_CACHE", str(tmp_path / "cache"))
    split, league = load_registry(registry).split("scratch"), tmp_path / "league"
    contrasts = tmp_path / "contrasts.toml"
    contrasts.write_text(
        f"""schema = 1
alpha = 0.05
[[contrasts]]
task = "scratch"
split = "{split.id}"
method = "gru"
baseline = "ppo"
seeds = 4
"""
    )

    def make(name: str, *more: str, seeds: str = "4") -> dict:
        words = ["row", name, "scratch", "--out", str(league), "--registry", str(registry), *more]
        capfd.readouterr()
        code = run([*words, "--seeds", seeds, "--contrasts", str(contrasts), *TINY])
        printed = capfd.readouterr()
        assert code == 0, printed.err
        return json.loads(printed.out)

    made = {
        name: make(name)
        for name in ("ppo", "ppo-best-of-4", "gru", "best-fixed", "mirror", "best-response")
    }
    counts = {name: record["robots"] for name, record in made.items()}
    assert counts == {
        **{"ppo": 4, "ppo-best-of-4": 2, "gru": 4, "best-fixed": 1},
        **{"mirror": 4, "best-response": 8},
    }
    ppo = made["ppo"]
    assert ppo["steps"] == 480 and ppo["total_steps"] == 4 * 480 and ppo["seeds"] == [0, 1, 2, 3]
    assert set(ppo["device_minutes"]) == {"training", "validation", "evaluation"}
    assert ppo["device_minutes_in_all"] > 0 and len(ppo["contrasts"]) == 64
    assert made["best-response"]["total_steps"] == 8 * 480
    teams = {name: set(_partners(league / "scratch" / name)) for name in made}
    assert all(teams[name] == set(split.test) for name in made if name != "best-response")
    assert len(teams["best-response"]) == 2 and teams["best-response"] < set(split.test)
    assert _partners(league / "scratch/runs/ppo/training/validation") == list(split.validation)
    [fixed] = made["best-fixed"]["robot_files"].values()
    assert fixed.rpartition("/")[0] in split.train
    together, league = league, tmp_path / "parts"  # of two seeds each: the same robots
    apart = [make("ppo", "--part", part) for part in ("1/2", "2/2")]
    assert [part["seeds"] for part in apart] == [[0, 1], [2, 3]] and "m_test" not in apart[0]
    joined = {name: make(name, "--part", "all/2") for name in ("ppo", "ppo-best-of-4")}
    for name, record in joined.items():
        alike = ("seeds", "robots", "steps", "total_steps", "split", "contrasts")
        assert [record[key] for key in alike] == [made[name][key] for key in alike]
        assert record["robot_files"].keys() == made[name]["robot_files"].keys()
        assert record["m_test"]["mean"] == pytest.approx(made[name]["m_test"]["mean"], rel=0.01)
    curves = [
        pl.read_parquet(place / "scratch/runs/ppo/training/validation.parquet")
        for place in (league, together)
    ]
    assert_frame_equal(*curves, rel_tol=0.01)
    spent = sum(part["device_minutes"]["training"] for part in apart)
    assert joined["ppo"]["device_minutes"]["training"] == pytest.approx(spent, abs=0.02)
    with pytest.raises(AssertionError, match=r"of seeds 0, 1, 2, 3, .*; wanted are seeds 4, 5 "):
        make("ppo", "--part", "all/2", seeds="4-5")
    league = together
    with pytest.raises(AssertionError, match="is a training of all seeds at once"):
        make("ppo", "--part", "all/2")
    again = make("ppo")  # found finished: the same, and the minutes that it took
    assert again["m_test"] == ppo["m_test"]
    assert again["device_minutes"]["evaluation"] >= ppo["device_minutes"]["evaluation"]
    found = read_league(league / "scratch")
    assert [row.row for row in found.rows][:2] == ["zero-action", "uniform-random"]
    assert list(row_folders(league / "scratch")) == [
        *("best-fixed", "ppo", "ppo-best-of-4", "gru", "mirror", "best-response")
    ]
    trained = make("best-response", "--side", "train")
    side = row_folders(league / "scratch/training-side")
    assert trained["robots"] == 8 and list(side) == ["ppo", "gru", "best-response"]
    met = {tuple(_partners(place)) for place in side.values()}
    assert len(met) == 1 and set(*met) < set(split.train)
    out, images = tmp_path / "tables", tmp_path / "images"
    words = ["page", str(league), "--out", str(out), "--images", str(images)]
    assert run([*words, "--contrasts", str(contrasts)]) == 0
    assert {path.name for path in out.iterdir()} == {
        *("scratch-league.csv", "scratch-partners.csv", "scratch-validation.csv"),
        "scratch-training-side.csv",
        *("rows.csv", "contrasts.csv", "contrasts.json"),
    }
    assert {path.name for path in images.iterdir()} == {
        *("league.png", "partners.png", "validation.png")
    }
    assert pl.read_csv(out / "contrasts.csv")["method"].to_list() == ["gru"]
    assert pl.read_csv(out / "rows.csv")["device_minutes_in_all"].null_count() == 0
    assert pl.read_csv(out / "scratch-validation.csv").height == 2 * 4 * 2


@pytest.mark.slow
def test_a_told_best_response_of_a_gentle_task(tmp_path: Path, capfd, monkeypatch) -> None:
    """Robots observe what the human likes, so another environment trains and plays them."""
    monkeypatch.setattr("assistax_envs.env.EPISODE_LENGTH", 20)
    task = "gentle_scratch"
    teams = untrained.teams_of(10, *untrained.gentle_specs(task), task=task)
    path = untrained.published(teams, tmp_path / "zoo")
    # Humans that nobody trained act alike.
    monkeypatch.setattr("zoo.splitting.create.similar_pairs", lambda registry, split: [])
    split = create_split(path, task=task, rule="three-sides")
    words = ["row", "told-best-response", task, "--split", split.id, "--seeds", "1"]
    words += ["--registry", str(path)]
    fused = ["fused" if word == "native" else word for word in TINY]
    assert run([*words, "--out", str(tmp_path / "league"), *fused]) == 0
    record = json.loads(capfd.readouterr().out)
    assert record["robots"] == 2 and record["total_steps"] == 2 * 480
    row = tmp_path / "league" / "gentle_scratch" / "told-best-response"
    assert len(_partners(row)) == 2 and set(_partners(row)) < set(split.test)
    [seen] = {read_policy_file(path)[0].observation_size for path in record["robot_files"].values()}
    own = load_registry(path).policy(f"{split.train[0]}/robot").spec.observation_size
    assert seen > own


@pytest.mark.slow
def test_rows_play_persons_and_teams_but_bounds_play_persons(
    tmp_path: Path, capfd, monkeypatch
) -> None:
    monkeypatch.setattr("assistax_envs.env.EPISODE_LENGTH", 20)
    task, path, league = "gentle_scratch", tmp_path / "registry.json", tmp_path / "league"
    teams = untrained.teams_of(3, *untrained.gentle_specs(task), task=task)
    earned = {"mean": 100.0, "iqm": 100.0, "mean_ci": [0.0, 100.0], "n": 8}
    weak = {**earned, "mean": 1.0}  # its team is on no side
    teams = [
        dataclasses.replace(team, self_play=weak if place == 4 else earned)
        for place, team in enumerate(teams)
    ]
    publish(teams, path, "v1", persons=[task], date="2027-01-31")
    registry = load_registry(path)
    split, (alone, _) = registry.split(task), person_splits(registry.data, task)
    sizes = ["--registry", str(path), "--persons", "4", "--no-references", "--seeds", "2", *TINY]
    competent = {team for team in split.test if is_team(team)}
    assert len(competent) == 3
    of_persons, met = {"mirror", "best-response", "told-partner"}, dict[str, set[str]]()
    for name in ("ppo", "mixed", *sorted(of_persons)):
        code, printed = run(["row", name, task, "--out", str(league), *sizes]), capfd.readouterr()
        assert code == 0, printed.err
        record, row = json.loads(printed.out), league / task / name
        learned = split.id if name == "mixed" else alone.id
        assert (record["split"], record["training_split"]) == (split.id, learned)
        summary, played = read_summary(row), {*_partners(row)}
        assert isinstance(summary, EvaluationSummary) and summary.m_test and summary.split
        assert record["m_test"]["mean"] == summary.m_test.mean
        assert summary.split.id == (alone.id if name in of_persons else split.id)
        chosen = {team for team in played if is_team(team)}
        assert chosen <= competent and len(chosen) == (0 if name in of_persons else 2)
        met[name] = played - chosen
    assert met.pop("best-response") < met["ppo"] and len({*map(frozenset, met.values())}) == 1
    for found in read_league(league / task).rows:
        means = [figure.mean for figure in found.by_group.values()]
        assert found.mean.mean == pytest.approx(np.mean(means))
        assert ("teams" in found.by_group) == (found.row not in of_persons)
    assert run(["page", str(league), "--text", str(tmp_path / "page.md")]) == 0
    assert "play the persons alone" in (tmp_path / "page.md").read_text()


def _partners(folder: Path) -> list[str]:
    return sorted(Record.read(folder).returns.partners["partner_team"])


def written_page(tmp_path: Path, capsys, contrasts: str) -> str:
    """Return the page of a league's rows."""
    named, text = tmp_path / "contrasts.toml", tmp_path / "docs/results.md"
    named.write_text(contrasts)
    words = ["page", str(tmp_path / "league"), "--contrasts", str(named), "--text", str(text)]
    places = ["--out", str(tmp_path / "docs/data"), "--images", str(tmp_path / "docs/images")]
    assert run([*words, *places]) == 0, capsys.readouterr().err
    return text.read_text()


def test_the_page_says_what_the_rows_say(tmp_path: Path, capsys) -> None:
    put(tmp_path / "league/scratch", "ppo", np.full((4, 10), 200.0), baselines=True)
    put(tmp_path / "league/scratch", "gru", np.full((4, 10), 300.0))
    put(tmp_path / "league/scratch", "told-preference", np.full((4, 10), 350.0))
    put(tmp_path / "league/scratch/training-side", "gru", np.full((4, 10), 380.0))
    put(tmp_path / "league/scratch/training-side", "best-response", np.full((4, 10), 400.0))
    page = written_page(tmp_path, capsys, NAMED)
    [row] = [line for line in page.splitlines() if line.startswith("| `scratch` | `gru` |")]
    best, plain, _, told = [cell.strip() for cell in row.split("|")[3:7]]
    assert best.startswith("**300") and plain.startswith("200") and told.startswith("350")
    assert row.endswith("| 0 of 10 partners |") and "`gru` wins 66% of 151 points" in page
    beside = "each trained for one training person, the best of each four seeds, `gru` earns 380"
    assert f"{beside} of 400 (95%) in `scratch`" in page
    assert page.count("](images/") == 2  # nobody was validated, so there are no curves
    assert "nan" not in page and "Above PPO at Holm's 5% over all named contrasts: `gru`" in page
    first_screen = page[: page.index("![")]
    assert len([line for line in first_screen.splitlines() if line[:1].isdigit()]) <= 10


def test_page_of_persons_and_teams_shows_each_group(tmp_path: Path, capsys) -> None:
    put_beside_teams(tmp_path / "league/scratch")
    page = written_page(
        tmp_path, capsys, NAMED.replace("scratch-half-v0", "persons-s0-v0-11111111")
    )
    assert "| row | task | return | known families | unseen family | teams |" in page
    lines = {line.split("`")[1]: line for line in page.splitlines() if line.startswith("| `")}
    cells = [cell.split() for cell in lines["mirror"].split("|")[3:7]]
    assert [cell[0] if cell else "" for cell in cells] == ["200", "150", "250", ""]
    assert lines["ppo"].count("[") == 4, "each figure has an interval"
    assert "`mirror`, `told-best-response` play the persons alone: teams have no" in page
    assert "whose groups count alike" in page and "`gru` - `ppo` | `scratch` | 30 " in page
    assert "of 11 partners |" in page
    partners = pl.read_csv(tmp_path / "docs/data/scratch-partners.csv")
    assert set(partners["family"]) == {"spring", "stepper", "teams"}
    table = pl.read_csv(tmp_path / "docs/data/scratch-league.csv")
    assert table.filter(row="mirror")["teams"].to_list() == [None]
    again = read_tables(tmp_path / "docs/data").league["scratch"]
    assert_frame_equal(again, table)


def test_page_without_groups_has_no_table_of_them(tmp_path: Path, capsys) -> None:
    for row in ("ppo", "gru"):
        put(tmp_path / "league/scratch", row, np.full((4, 10), 200.0), baselines=row == "ppo")
    page = written_page(tmp_path, capsys, NAMED)
    assert "| row | task |" not in page and "persons alone" not in page


@pytest.mark.parametrize(
    ("rule", "of", "is_named"),
    [("half", "split", True), ("small-5", "split", False), ("half", "training_split", True)],
)
def test_page_names_published_robots_of_chosen_methods(
    rule: str, of: str, is_named: bool, tmp_path: Path, capsys
) -> None:
    """Those that learned with the same split as the league's."""
    place = tmp_path / "league/scratch"
    put(place, "ppo", np.full((4, 10), 200.0), baselines=True)
    put(place, "gru", np.full((4, 10), 150.0))
    (place / "runs/ppo").mkdir(parents=True)
    split = load_registry().split("scratch", rule).id
    record = {"split": "scratch/persons-s0-v1-01234567", of: split}
    (place / "runs/ppo/row.json").write_text(json.dumps(record))
    page = written_page(tmp_path, capsys, NAMED)
    assert ("names: `scratch/ppo-ego-s0-v1`. [Tracks]" in page) == is_named


def test_validation_chooses_methods_and_contrasts_name_ppo(tmp_path: Path, capsys) -> None:
    """What is best with the test side is said, and no choice."""
    place = tmp_path / "league/scratch"
    rows_of = ("ppo", 200.0, 210.0), ("gru", 300.0, 290.0), ("liam", 280.0, 310.0)
    for name, test, validated in rows_of:
        put(place, name, np.full((4, 10), test), baselines=name == "ppo")
        curve = place / f"runs/{name}/training/validation.parquet"
        curve.parent.mkdir(parents=True)
        steps, seeds = [10, 20] * 4, np.repeat(range(4), 2)
        returns = [validated, validated - 400] * 4  # each seed's best checkpoint counts
        pl.DataFrame({"seed": seeds, "steps": steps, "return": returns}).write_parquet(curve)
    contrasts = NAMED.replace('baseline = "ppo"', 'baseline = "liam"')
    page = written_page(tmp_path, capsys, contrasts)
    assert "| `scratch` | `liam` | **280" in page
    assert "another method has a higher mean: `gru` in `scratch` (300, `liam` 280)" in page
    assert "| `gru` - `liam` | `scratch` | 20 " in page
    assert "Above PPO" not in page and "Not shown" not in page


def test_earlier_rows_join_new_ones(tmp_path: Path, capsys) -> None:
    """Rows that are made anew take the place of older ones, and p is corrected over both."""
    contrasts = tmp_path / "contrasts.toml"
    contrasts.write_text(NAMED.replace('"sac"', '"liam"'))

    def page(name: str, *more: str) -> str:
        text = tmp_path / name / "results.md"
        words = ["page", str(tmp_path / name), "--contrasts", str(contrasts), "--text", str(text)]
        assert run([*words, *more]) == 0, capsys.readouterr().err
        return text.read_text()

    def table(name: str, what: str) -> pl.DataFrame:
        return pl.read_csv(tmp_path / name / f"page/{what}.csv")

    def play(name: str, row: str, returns: float) -> None:
        noise = np.random.default_rng(len(row)).normal(0.0, 20.0, (4, 10))
        put(tmp_path / name / "scratch", row, returns + noise, baselines=row == "ppo")

    for row, returns in (("ppo", 200.0), ("gru", 260.0)):
        play("old", row, returns)
    page("old")
    for row, returns in (("ppo", 210.0), ("liam", 240.0)):
        play("new", row, returns)
    earlier = ["--earlier", str(tmp_path / "old/page")]
    text = page("new", *earlier)
    league = table("new", "scratch-league")
    assert league["row"].to_list()[3:] == ["ppo", "gru", "liam"]
    means = dict(league.select("row", "mean").iter_rows())
    older = dict(table("old", "scratch-league").select("row", "mean").iter_rows())
    assert means["gru"] == older["gru"] and means["ppo"] == pytest.approx(older["ppo"] + 10)
    chances = {line["method"]: line for line in table("new", "contrasts").iter_rows(named=True)}
    alone = table("old", "contrasts").row(0, named=True)
    assert chances["gru"]["p"] == alone["p"] and set(chances) == {"gru", "liam"}
    least, most = sorted(line["p"] for line in chances.values())
    found = sorted(line["p_holm"] for line in chances.values())
    assert found == pytest.approx([2 * least, max(2 * least, most)], abs=2e-6)
    assert "| `gru` - `ppo` |" in text and "| `liam` - `ppo` |" in text
    partners = table("new", "scratch-partners")
    best = partners.group_by("partner").agg(pl.col("mean").max())
    kept = partners.filter(row="gru").join(best, on="partner", suffix="_best")
    assert (kept["best"] - kept["mean_best"]).abs().max() == 0
    again = read_tables(tmp_path / "new/page").write(tmp_path / "again")
    for path in again:
        assert path.read_bytes() == (tmp_path / "new/page" / path.name).read_bytes(), path.name
    renamed = contrasts.read_text().replace('"gru"', '"palm"').replace("seeds = 4", "seeds = 5")
    contrasts.write_text(renamed)  # of other methods, or with more seeds
    page("new", *earlier)
    assert not table("new", "contrasts")["named"].any()
    path = tmp_path / "old/page/rows.csv"  # a task of another split has its new rows alone
    records = pl.read_csv(path).with_columns(pl.lit("scratch/half-s0-v9-01234567").alias("split"))
    records.write_csv(path)
    runs = tmp_path / "new/scratch/runs/ppo"
    runs.mkdir(parents=True)
    (runs / "row.json").write_text(json.dumps({"split": "scratch/half-s0-v8-01234567"}))
    page("new", *earlier)
    assert table("new", "scratch-league")["row"].to_list()[3:] == ["ppo", "liam"]
    assert run(["page", str(tmp_path / "new"), "--earlier", str(tmp_path)]) == 1
    assert "has no tables of a league's page" in capsys.readouterr().err


def test_contrast_may_lack_an_interval() -> None:
    """One episode of one pair gives none."""
    known = {"named": True, "p": 1.0, "p_holm": 1.0, "found": False, "detectable_holm": 9.0}
    alone = ShownContrast(
        "scratch", "gru", "ppo", "return", mean=60.0, low=None, high=None, **known
    )
    [told] = [text for text in sentences([], [alone], [], 0.05) if "Not shown" in text]
    assert "`gru` in `scratch`" in told
    whole = dataclasses.replace(alone, found=True)
    assert "`gru` in `scratch` (+60)" in next(iter(sentences([], [whole], [], 0.05)))
    ended = dataclasses.replace(whole, low=50.0, high=70.0)
    assert "`gru` in `scratch` (+60 [50, 70])" in next(iter(sentences([], [ended], [], 0.05)))


@pytest.mark.slow
def test_cards_have_film_and_m_test(tmp_path: Path, capsys) -> None:
    robot, out = load_registry().of_task("gentle_brushing", "robot")[0].team, tmp_path / "cards"
    words = ["cards", f"{robot}/robot", "--out", str(out), "--persons", "2", "--steps", "5"]
    assert run(words) == 0, capsys.readouterr().err
    place = out / robot.replace("/", "-")
    film = place / "film.webp"
    card, before = (place / "card.md").read_text(), film.stat().st_mtime_ns
    assert "](<film.webp>)" in card and "with 2 partners of the test side of" in card
    assert f"[{robot}]({place.name}/card.md)" in (out / "README.md").read_text()
    assert run(words) == 0 and film.stat().st_mtime_ns == before, "made once"
    assert run(["cards", "scratch/ippo-*", "--out", str(out)]) == 1
    assert "no robot that learned with" in capsys.readouterr().err


MAKER = """
import json, os, pathlib, sys, time
row, task, *words = sys.argv[1:]
place = pathlib.Path(words[-1], f"{task}-{row}" + "-side" * ("train" in words))
before = sorted(path.name for path in place.parent.glob("*-*"))
known = "CUDA_VISIBLE_DEVICES", "XLA_PYTHON_CLIENT_MEM_FRACTION"
own = {name: os.environ[name] for name in known}
time.sleep(0.2)
if row == "liam" or row == "gru" and not place.with_suffix(".once").exists():
    place.with_suffix(".once").touch()
    sys.exit("a full card")
place.write_text(json.dumps({"before": before, **own}))
"""


def test_queue_joins_parts_when_all_are_made(tmp_path: Path) -> None:
    file, out = tmp_path / "queue.txt", tmp_path / "league"
    rows_of = ("ppo-best-of-4", "ppo")
    lines = [f"2 {row} scratch --part all/2" for row in rows_of]
    lines += [f"2 ppo scratch --seeds 4 --part {part}/2" for part in (1, 2)]
    file.write_text("\n".join(lines))
    waiting = read_queue(file)
    names = [f"scratch-ppo-part-{part}-of-2" for part in (1, 2)]
    assert [queued.name for queued in waiting[2:]] == names
    program = (sys.executable, "-c", "print(1)")
    events = list(run_queue(waiting, out, {"0": 80.0}, program, 0.02))
    ends = [line.split()[0] for line in events if " ended with 0 " in line]
    assert set(ends[:2]) == set(names) and len(ends) == 4


def test_queue_shares_cards_and_waits_for_needs(tmp_path: Path) -> None:
    file, out = tmp_path / "queue.txt", tmp_path / "league"
    file.write_text(
        """# best responses, and the best of four, come last whatever the order
        4 best-response scratch --side train
        2 ppo-best-of-4 scratch
        22 ppo scratch --seeds 100-131  # which two do not fit on a card
        22 gru scratch
        22 asymmetric scratch
        2 ppo bed_bath
        """
    )
    program = (sys.executable, "-c", MAKER)
    lines = list(run_queue(read_queue(file), out, {"0": 40.0, "3": 80.0}, program, 0.02))
    made = {path.name: json.loads(path.read_text()) for path in out.glob("*-*") if not path.suffix}
    assert set(made) == {
        *("scratch-ppo", "scratch-gru", "scratch-asymmetric", "bed_bath-ppo"),
        *("scratch-ppo-best-of-4", "scratch-best-response-side"),
    }
    assert "scratch-ppo" in made["scratch-ppo-best-of-4"]["before"]
    side = set(made["scratch-best-response-side"]["before"])
    assert {"scratch-ppo", "scratch-gru", "scratch-asymmetric", "scratch-ppo-best-of-4"} <= side
    shares = {"0": 22 / 40, "3": 22 / 80}
    for name in ("scratch-ppo", "scratch-gru", "scratch-asymmetric"):
        own = made[name]
        share = float(own["XLA_PYTHON_CLIENT_MEM_FRACTION"])
        assert share == pytest.approx(shares[own["CUDA_VISIBLE_DEVICES"]], abs=1e-3)
    assert "scratch-gru ended with 1 on " in "\n".join(lines)  # and was tried again
    assert "a full card" in (out / "logs/scratch-gru.log").read_text()
    running, most = {"0": 0, "3": 0}, {"0": 0, "3": 0}
    for line in lines:
        card = line.rpartition(" ")[2]
        if line.split()[0] in ("scratch-ppo", "scratch-gru", "scratch-asymmetric"):
            running[card] += 1 if "starts" in line else -1
            most[card] = max(most[card], running[card])
    assert most["0"] <= 1 and most["3"] <= 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("9 liam scratch", "rows failed 2 times: scratch-liam; see "),
        ("90 gru scratch", "takes 90 GB and 8 beside them; the largest card has 80"),
        ("9 dreamer scratch", "line 1 is '9 dreamer scratch' .row is 'dreamer'; allowed are"),
        ("gru scratch", "line 1 is 'gru scratch'"),
        ("9 gru scratch\n9 gru scratch --split half", "has scratch-gru twice"),
    ],
)
def test_impossible_queue_gets_one_error(text: str, message: str, tmp_path: Path) -> None:
    file, program = tmp_path / "queue.txt", (sys.executable, "-c", MAKER)
    file.write_text(text)
    with pytest.raises(ValueError, match=message):
        list(run_queue(read_queue(file), tmp_path / "out", {"0": 80.0}, program, 0.02))
