"""The page: self-contained, safe against hostile ids, and working in a browser."""

import base64
import json
import re
import shutil
from collections.abc import Generator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import jinja2
import numpy as np
import polars as pl
import pytest
from playwright.sync_api import Browser, Page

from evaluation.figures import normalised as relative
from evaluation.figures import saved_tables as derived
from evaluation.player.worst_pair import worst_pair
from evaluation.plots.figures import crossplay_figure, evaluation_figure
from evaluation.record import tables
from evaluation.record.manifest import MANIFEST_FILE, seal, write_manifest, write_run
from evaluation.record.record import Record
from evaluation.report import write_report
from evaluation.report.matrix_data import matrix_data
from evaluation.report.page import templates
from tests.board.browser import browsing
from tests.evaluation.episode_tables import CONTEXT, clustered_matrix, episode_table, team_id, teams
from tests.system import CHROMIUM, needs
from zoo.registry import load_registry

ROOT = Path(__file__).parents[2]
HOSTILE = "python:my</script><script>alert(1)</script>&amp;:f"
COMMAND = "assistax-zoo crossplay --task scratch --seed 7 --out 'x & <y>'"
IDENTITY = {"task": "scratch", "seed": 5, "apart": True, "egos": [], "partners": []}


def save_crossplay(folder: Path, table: pl.DataFrame) -> Path:
    folder.mkdir(exist_ok=True)
    tables.write_episodes(table, folder / tables.EPISODES_FILE)
    derived.save_crossplay(Record(table, folder), CONTEXT)
    write_manifest(folder, {"identity": IDENTITY})
    write_run(folder, COMMAND, simulated=True)
    return folder


@pytest.fixture(scope="module")
def crossplay(tmp_path_factory: pytest.TempPathFactory) -> Path:
    population = teams(12, ("ippo", "isac"), ("d1", "d9"))
    returns = clustered_matrix(12, 3)[:, :, None] + np.array([-1.0, 1.0])
    return save_crossplay(
        tmp_path_factory.mktemp("xp"), episode_table(returns, population, population)
    )


@pytest.fixture(scope="module")
def evaluation(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mine")
    partners = teams(6, ("ippo",), ("d1", "d9"))
    sides = ["test", "train"] * 3
    table = episode_table(
        np.random.default_rng(0).normal(500, 50, (2, 6, 2)), [HOSTILE, "b"], partners, sides
    )
    tables.write_episodes(table, folder / tables.EPISODES_FILE)
    low = episode_table(np.full((1, 6, 2), 10.0), ["zero-action"], partners, sides)
    bounds = relative.bounds_table(played := low.with_columns(reference=low["ego"]))
    derived.save_evaluation(Record(table, folder), CONTEXT, references=(played, bounds))
    write_run(folder, COMMAND, simulated=True)
    return folder


def page_of(folder: Path, tmp_path: Path) -> str:
    write_report(folder, tmp_path / "report.html")
    return (tmp_path / "report.html").read_text(encoding="utf-8")


class Links(HTMLParser):
    """Collector of a page's links and elements."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.tags: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.loaded += [
            str(value)
            for name, value in attrs
            if name in ("src", "href", "action", "data", "srcset")
        ]


def loads_from_elsewhere(text: str) -> list[str]:
    links = [link for link in Links(text).loaded if not link.startswith(("data:", "#"))]
    css = re.findall(r"url\(([^)]*)\)|@import\s+(\S+)", text)
    return [*links, *css, *re.findall(r"\b(fetch|XMLHttpRequest|WebSocket|import)\s*\(", text)]


def test_a_report_loads_nothing_from_elsewhere(crossplay: Path, evaluation: Path, tmp_path: Path):
    for folder in (crossplay, evaluation):
        assert loads_from_elsewhere(page_of(folder, tmp_path)) == []
    planted = '<img src="https://example.org/x.png"><script>fetch("/x")</script>'
    assert len(loads_from_elsewhere(planted)) == 2


def test_report_embeds_given_episodes(crossplay: Path, evaluation: Path, tmp_path: Path):
    """With the player of `watch`; without an episode nothing of it is there."""
    for folder in (crossplay, evaluation):
        bare = page_of(folder, tmp_path)
        assert "data-episode" not in bare and "THREE" not in bare
        write_report(folder, tmp_path / "played.html", [b"first", b"second"])
        text = (tmp_path / "played.html").read_text(encoding="utf-8")
        for data in (b"first", b"second"):
            assert text.count(f'data-episode="{base64.b64encode(data).decode()}"') == 1
        assert text.count("function playEpisode(") == text.count("var THREE=") == 1
        assert loads_from_elsewhere(text) == []


def test_a_pair_without_named_episodes_is_refused(crossplay: Path, tmp_path: Path):
    folder = Path(shutil.copytree(crossplay, tmp_path / "xp"))
    write_manifest(folder, {"identity": {**IDENTITY, "apart": False}})
    seal(folder)
    with pytest.raises(ValueError, match="does not name the episodes that it played"):
        worst_pair(folder, load_registry())


def test_crossplay_page_has_command_and_hashes(crossplay: Path, tmp_path: Path):
    text = page_of(crossplay, tmp_path)
    assert "--task scratch --seed 7 --out &#39;x &amp; &lt;y&gt;&#39;" in text
    for words in ("Cross-play: scratch", "scratch-half-v0", "release v0", "sha256", "Strategies"):
        assert words in text
    assert text.count("<tr>") > 20
    assert page_of(crossplay, tmp_path) == text


def test_tables_of_other_options_go(evaluation: Path, crossplay: Path, tmp_path: Path):
    """The same job without references has no regret; an evaluation is no cross-play."""
    folder = Path(shutil.copytree(evaluation, tmp_path / "mine"))
    shutil.copy(crossplay / tables.PAIRS_FILE, folder)
    assert "regret" in page_of(folder, tmp_path)
    table = tables.read_episodes(folder / tables.EPISODES_FILE)
    derived.save_evaluation(Record(table, folder), CONTEXT)
    seal(folder)
    assert "regret" not in page_of(folder, tmp_path)
    gone = {tables.REFERENCES_FILE, tables.BOUNDS_FILE, tables.PAIRS_FILE}
    assert gone.isdisjoint(path.name for path in folder.iterdir())
    played = Path(shutil.copytree(crossplay, tmp_path / "xp"))
    shutil.copy(evaluation / tables.PROFILE_FILE, played)
    derived.save_crossplay(
        Record(tables.read_episodes(played / tables.EPISODES_FILE), played), CONTEXT
    )
    assert not (played / tables.PROFILE_FILE).exists()
    assert (played / tables.STRATEGIES_FILE).exists()


def test_evaluation_page_has_references(evaluation: Path, tmp_path: Path):
    text = page_of(evaluation, tmp_path)
    for words in ("M_test", "zero action", "Unscorable", "source of B", "data:image/svg+xml"):
        assert words in text


@pytest.mark.parametrize(("people", "shown"), [(40, True), (8, False)])
def test_person_page_has_effects_of_numbers(people: int, shown: bool, tmp_path: Path):
    rng, partners = np.random.default_rng(0), teams(people)
    table = episode_table(
        rng.normal(100.0, 30.0, (1, people, 2)), ["a"], partners, ["test"] * people
    )
    names = {
        str(name): f"gentle_scratch/person-{number:05d}-v1/human"
        for number, name in enumerate(table["partner"].unique(maintain_order=True))
    }
    table = table.with_columns(pl.col("partner").replace_strict(names))
    folder = tmp_path / "persons"
    folder.mkdir()
    tables.write_episodes(table, folder / tables.EPISODES_FILE)
    derived.save_evaluation(Record(table, folder), CONTEXT)
    write_run(folder, COMMAND, simulated=True)
    text = page_of(folder, tmp_path)
    assert ('alt="which numbers of persons matter"' in text) == shown  # too few are no figure
    assert "disability setting" not in text and "person-00007" in text
    body = re.sub(r"<(script|style|svg).*?</\1>", "", text, flags=re.DOTALL)
    assert "Robot:" in body or "Robots, " in body
    assert "test persons of the family " in body and "Each person" in body
    assert not re.search(r"Policy:|\bone ego\b|partners of own|>own<|[Rr]eference egos", body)


def test_ids_cannot_break_out_of_the_page(evaluation: Path, tmp_path: Path):
    text = page_of(evaluation, tmp_path)
    assert "<script>alert" not in text
    assert Links(text).tags.count("script") == 1
    data = templates().from_string("{{ data|tojson }}").render(data={"id": HOSTILE, "a": 1})
    assert "<" not in data
    assert json.loads(data) == {"id": HOSTILE, "a": 1} and list(json.loads(data)) == ["id", "a"]


def attack(folder: Path, name: str, path: tuple[str, ...], value: Any) -> None:
    """Replace one field of a received file, and seal the folder as its sender can."""
    content = tables.read_json(folder / name)
    inner = content
    for key in path[:-1]:
        inner = inner[key]
    assert path[-1] in inner
    inner[path[-1]] = value
    tables.write_json(content, folder / name)
    seal(folder)


@pytest.mark.slow_for("path0", "path2", "path3")
@pytest.mark.parametrize(
    ("kind", "name", "path"),
    [
        ("crossplay", tables.STRATEGIES_FILE, ("br_div", "rank")),
        ("crossplay", tables.STRATEGIES_FILE, ("diverse_subset",)),
        ("crossplay", tables.SUMMARY_FILE, ("release",)),
        ("crossplay", tables.SUMMARY_FILE, ("best_ego", "ego")),
        ("evaluation", tables.SUMMARY_FILE, ("notes",)),
    ],
)
def test_received_fields_never_run(
    kind: str, name: str, path: tuple[str, ...], request: pytest.FixtureRequest, tmp_path: Path
):
    folder = Path(shutil.copytree(request.getfixturevalue(kind), tmp_path / "received"))
    clean = Links(page_of(folder, tmp_path)).tags.count("script")
    listed = path[-1] in ("notes", "diverse_subset")
    attack(folder, name, path, [HOSTILE] if listed else HOSTILE)
    text = page_of(folder, tmp_path)
    assert "<script>alert" not in text and "&lt;script&gt;alert" in text
    assert Links(text).tags.count("script") == clean


def test_strange_tables_error_names_folder(evaluation: Path, crossplay: Path, tmp_path: Path):
    def profile(folder: Path, out: Path) -> None:
        evaluation_figure([folder], "profile", out)

    for source, file, column, draw in (
        (crossplay, tables.PAIRS_FILE, "ego_algorithm", crossplay_figure),
        (evaluation, tables.PROFILE_FILE, "share", profile),
    ):
        folder = Path(shutil.copytree(source, tmp_path / column))
        tables.write_parquet(tables.read_parquet(folder / file).drop(column), folder / file)
        seal(folder)
        message = rf"{column} is damaged, or of another version \(Column"
        with pytest.raises(ValueError, match=message):
            draw(folder, tmp_path / "x.png")


@pytest.mark.parametrize("field", ["side", "episodes_per_pair", "nonfinite"])
def test_wrong_summary_field_is_named(field: str, evaluation: Path, tmp_path: Path):
    folder = Path(shutil.copytree(evaluation, tmp_path / "received"))
    attack(folder, tables.SUMMARY_FILE, (field,), HOSTILE)
    message = rf"is damaged, or of another version: .*{field}"
    with pytest.raises(ValueError, match=message):
        page_of(folder, tmp_path)
    with pytest.raises(ValueError, match=message):
        evaluation_figure([folder], "zsc", tmp_path / "x.png")


def test_changed_file_is_refused(evaluation: Path, tmp_path: Path):
    folder = Path(shutil.copytree(evaluation, tmp_path / "received"))
    bounds = tables.read_parquet(folder / tables.BOUNDS_FILE)
    tables.write_parquet(bounds.head(bounds.height // 2), folder / tables.BOUNDS_FILE)
    with pytest.raises(ValueError, match=r"bounds\.parquet: expected sha256"):
        page_of(folder, tmp_path)


def test_templates_escape_values():
    environment = templates()
    assert environment.from_string("<p>{{ a }}</p>").render(a="<b>") == "<p>&lt;b&gt;</p>"
    with pytest.raises(jinja2.UndefinedError):
        environment.from_string("{{ missing }}").render()
    assert set(environment.list_templates()) == {
        *("crossplay.html", "evaluation.html", "figures.html", "league.html", "macros.html"),
        *("page.html", "seat.html", "watch.html"),
    }
    for path in (ROOT / "evaluation" / "report").glob("**/*.*"):
        if path.suffix in (".py", ".html"):
            text = path.read_text(encoding="utf-8")
            assert not re.search(r"\|\s*safe\b|autoescape false|autoescape=False", text), path
            # What counts as HTML already: our own styles and scripts.
            assert text.count("Markup(") == (path.name == "page.py"), path


def test_matrix_data_holds_saved_pairs(crossplay: Path):
    pairs = tables.read_parquet(crossplay / tables.PAIRS_FILE)
    data = matrix_data(pairs, tables.read_json(crossplay / tables.STRATEGIES_FILE))
    expected = {(row["ego"], row["partner"]): row["return"] for row in pairs.iter_rows(named=True)}
    for r, row in enumerate(data["rows"]):
        for c, column in enumerate(data["columns"]):
            value = data["measures"]["return"]["values"][r][c]
            assert value == pytest.approx(expected[row["name"], column["name"]], rel=1e-3)
    for axes_order in data["orders"].values():
        assert sorted(axes_order["rows"]) == sorted(axes_order["columns"]) == list(range(12))
    shared = data["orders"]["teams"]
    assert [data["rows"][i]["team"] for i in shared["rows"]] == [
        data["columns"][i]["team"] for i in shared["columns"]
    ]


def test_page_ignores_forged_order(tmp_path: Path):
    population = teams(6)
    table = episode_table(clustered_matrix(6, 2)[:, :, None], population, population)
    derived.save_crossplay(Record(table, tmp_path), CONTEXT)
    path, pages = tmp_path / tables.ORDER_FILE, []
    forged = tables.read_json(path)
    for axis in ("rows", "columns", "teams"):
        forged[axis]["order"].reverse()
    for content in (tables.read_json(path), forged):
        tables.write_json(content, path)
        write_report(tmp_path, tmp_path / "x.html")
        pages.append((tmp_path / "x.html").read_text())
    assert pages[0] == pages[1]


def test_a_folder_of_neither_kind_is_refused(tmp_path: Path):
    with pytest.raises(FileNotFoundError, match=r"summary\.json does not exist"):
        write_report(tmp_path, tmp_path / "x.html")
    tables.write_json({"task": "scratch"}, tmp_path / tables.SUMMARY_FILE)
    with pytest.raises(ValueError, match="neither an evaluation nor a cross-play"):
        write_report(tmp_path, tmp_path / "x.html")
    assert not (tmp_path / "x.html").exists()


@pytest.fixture(scope="module")
def browser() -> Generator[Browser]:
    with browsing() as browser:
        yield browser


def opened(browser: Browser, address: str, width: int = 1280, height: int = 1400) -> Page:
    """Open a report and its drawn matrix."""
    page = browser.new_page(viewport={"width": width, "height": height})
    page.goto(address)
    page.wait_for_selector("body[data-matrix]")
    return page


@pytest.mark.slow
@needs("chromium", CHROMIUM)
def test_browser_draws_matrix_and_finds_pair(browser: Browser, crossplay: Path, tmp_path: Path):
    page_of(crossplay, tmp_path)
    robot, human = (f"{team_id(teams(12, ('ippo', 'isac'), ('d1', 'd9'))[i])}" for i in (3, 7))
    robot, human = f"{robot}/robot", f"{human}/human"
    address = (tmp_path / "report.html").as_uri()
    page = opened(browser, f"{address}#{urlencode({'robot': robot, 'human': human})}")
    assert page.locator("body").get_attribute("data-matrix") == "12x12"
    pairs = tables.read_parquet(crossplay / tables.PAIRS_FILE)
    value = pairs.filter(ego=robot, partner=human)["return"].item()
    tip = page.locator("#tip").inner_text()
    assert f"cross-play: {value:.0f}" in tip and f"robot {robot}" in tip
    broken = tmp_path / "broken.html"
    text = (tmp_path / "report.html").read_text()
    broken.write_text(text.replace("const data =", "throw 1; const data ="))
    page.goto(broken.as_uri())
    assert page.locator("body[data-matrix]").count() == 0


def film_of(page: str) -> dict[str, Any] | None:
    data = re.search(r'id="matrix-data">(.*?)</script>', page)
    assert data is not None
    return json.loads(data[1])["film"]


@pytest.mark.slow
def test_film_command_matches_manifest(crossplay: Path, tmp_path: Path):
    """The command is made from the manifest, because a study in Python has no command."""
    film = {"command": "assistax-zoo render --task scratch --seed 5", "preferences": {}}
    assert film_of(page_of(crossplay, tmp_path)) == film
    folder = Path(shutil.copytree(crossplay, tmp_path / "xp"))
    table = tables.read_episodes(folder / tables.EPISODES_FILE)
    first = pl.when(pl.col("partner_seed") == 0).then(pl.lit("p3")).otherwise(pl.lit("p5"))
    preference = pl.when(pl.col("episode") == 0).then(first).otherwise(pl.lit("p1"))
    tables.write_episodes(table.with_columns(preference=preference), folder / tables.EPISODES_FILE)
    gentle = {**IDENTITY, "task": "x; rm -r .", "preferences": ["p1", "p3", "p5"]}
    write_manifest(folder, {"identity": gentle})
    seal(folder)
    film_shown = film_of(page_of(folder, tmp_path))
    assert film_shown is not None and "--task 'x; rm -r .' --seed 5" in film_shown["command"]
    assert sorted(film_shown["preferences"]) == sorted(set(table["partner"]))
    assert {film_shown["preferences"][f"{team_id(('ippo', 'd1', 0))}/human"]} == {"p3"}
    assert set(film_shown["preferences"].values()) == {"p3", "p5"}
    write_manifest(folder, {"identity": {**IDENTITY, "apart": False}})
    seal(folder)
    assert film_of(page_of(folder, tmp_path)) is None
    assert "nothing of it was checked" not in page_of(folder, tmp_path)
    (folder / MANIFEST_FILE).unlink()
    page = page_of(folder, tmp_path)
    assert film_of(page) is None and "nothing of it was checked" in page
    write_manifest(folder, {"identity": IDENTITY, "files": {}})
    assert "hence not checked: episodes.parquet, pairs.parquet" in page_of(folder, tmp_path)


@pytest.mark.slow
@needs("chromium", CHROMIUM)
def test_held_pair_has_address_and_command(browser: Browser, crossplay: Path, tmp_path: Path):
    page_of(crossplay, tmp_path)
    page = opened(browser, (tmp_path / "report.html").as_uri())
    assert page.locator("#pair").is_hidden()
    box = page.locator("#matrix").bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + 0.4 * box["width"], box["y"] + 0.6 * box["height"])
    tip = page.locator("#tip").inner_text()
    robot, human = re.findall(r"^(?:robot|human) (\S+)", tip, re.MULTILINE)
    address = page.locator("#pair-address").inner_text()
    assert address == page.url and address.endswith(urlencode({"robot": robot, "human": human}))
    command = page.locator("#pair-command").inner_text()
    assert command == (
        f"assistax-zoo render --task scratch --seed 5 --robot {robot} --human {human} "
        "--out pair.mp4"
    )
    page.locator("#pair button").last.click()
    page.wait_for_function(
        "['copied', 'selected'].includes(document.querySelectorAll('#pair button')[1].textContent)"
    )
    assert f"human {human}" in opened(browser, address).locator("#tip").inner_text()
    page.locator("#all").click()
    assert page.locator("#pair").is_hidden() and "#" not in page.url


@pytest.mark.slow
@needs("chromium", CHROMIUM)
def test_find_scrolls_to_matches(browser: Browser, tmp_path: Path):
    population = teams(120, ("ippo", "isac"), ("d1", "d9"))
    table = episode_table(clustered_matrix(120, 3)[:, :, None], population, population)
    folder = save_crossplay(tmp_path / "large", table)
    page_of(folder, tmp_path)
    page = opened(browser, (tmp_path / "report.html").as_uri(), 1000, 700)
    name = tables.read_json(folder / tables.ORDER_FILE)["teams"]["order"][100]

    def shown() -> bytes:
        return page.locator("#matrix").screenshot()

    before = shown()
    page.locator("#find").fill(name)
    assert page.locator("#find").get_attribute("title") == "1 of 2"
    first = shown()
    page.locator("#find").press("Enter")
    assert page.locator("#find").get_attribute("title") == "2 of 2"
    assert len({before, first, shown()}) == 3
    box = page.locator("#matrix").bounding_box()
    assert box is not None
    across = range(round(box["x"]) + 200, round(box["x"] + box["width"]) - 10, 6)
    humans = set()
    for x in across:  # its column is among those that are shown
        page.mouse.move(x, 350)
        humans |= set(re.findall(r"^human (\S+)/human", page.locator("#tip").inner_text(), re.M))
    assert name in humans and len(humans) < 120
    page.locator("#find").fill("nobody")
    assert page.locator("#find").get_attribute("title") == ""
