"""Pages: all are there, none runs what a name holds, forms are answered to their writers."""

import dataclasses
import hashlib
import json
import os
import re
import shutil
import subprocess
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import sqlalchemy as sa
from limits import parse
from starlette.testclient import TestClient

from assistax_board.api import guards
from assistax_board.app import create_app
from assistax_board.pages import behind, boards
from assistax_board.pages.cache import PageCache
from assistax_board.pages.charts import axis_over
from assistax_board.pages.crossplays import PUBLISHED, CrossPlays
from assistax_board.pages.routes import films as film_routes
from assistax_board.pages.security import FIELD
from assistax_board.pages.videos import Pair, Videos, run_command
from assistax_board.service import Service
from assistax_board.store import schema
from assistax_board.store.database import Database
from assistax_board.store.schema import SCORE, SUBMISSION
from assistax_envs.persons.rows import described_numbers, person
from tests.board.board_data import HOSTILE, Robot, make_app
from tests.board.fakes import TASK, FakeFiles, declared, new_submitter, scored, work_off
from tests.untrained import published, teams_of
from zoo.exports.policies import Format, policy_file
from zoo.registry import load_registry

PAIR = "/pairs/scratch/ippo-d1-s0-v1/ippo-d1-s1-v1"
EXPLORER = "/tasks/scratch/explorer"


def linked(client: TestClient, page: str, pattern: str) -> str:
    """Return the first address on a page that looks like `pattern`."""
    found = re.search(rf'href="({pattern})"', client.get(page).text)
    assert found, f"{page} has no link like {pattern}"
    return found[1]


def form_token(client: TestClient, page: str) -> str:
    """Return the token of a form that was just loaded."""
    found = re.search(rf'name="{FIELD}" value="(\w+)"', client.get(page).text)
    assert found
    return found[1]


@pytest.fixture(scope="module")
def submissions(client: TestClient) -> tuple[str, str]:
    """The addresses of a scored submission and of one that waits."""
    page = client.get("/tasks/scratch").text
    queued = re.search(r'class="queue">.*?href="([^"]+)"', page, re.DOTALL)
    assert queued
    return linked(client, "/tasks/scratch", r"/submissions/\w+"), queued[1]


@pytest.fixture(scope="module")
def addresses(client: TestClient, submissions: tuple[str, str]) -> list[str]:
    return [
        *("/", "/tasks/scratch", "/tasks/arm_assist", "/tasks/scratch/heatmap", "/tasks/nowhere"),
        *("/tasks/scratch?sort=iqm&search=o&show=methods", "/tasks/scratch/compare"),
        *("/tasks/scratch/partners", "/tasks/scratch/partners?algorithm=ippo&disability=d3"),
        *("/partners/scratch/ippo-d1-s0-v1", "/partners/gentle_scratch/person-00042-v1"),
        *(PAIR, EXPLORER, *submissions, f"{submissions[0]}/method"),
        *("/seasons", linked(client, "/seasons", r"/seasons/\w+"), "/ledger"),
        *("/submit", "/submit?task=bed_bath", "/organise", "/docs"),
    ]


class Elements(HTMLParser):
    """Every element of a page with its attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))


def inline(text: str) -> list[str]:
    """Return what a strict policy would refuse to run, or what a name has brought into a page."""
    bad = []
    for tag, attributes in Elements(text).found:
        bad += [name for name in attributes if name.startswith("on") or name == "style"]
        bad += [tag] if tag == "style" or (tag == "script" and not attributes.get("src")) else []
        bad += [tag] if (attributes.get("src") or "").startswith("x") else []
    return bad


def test_every_page_is_there_and_holds_nothing_inline(
    client: TestClient, addresses: list[str]
) -> None:
    for address in addresses:
        answer = client.get(address)
        assert answer.status_code == (404 if "nowhere" in address else 200), address
        assert inline(answer.text) == [], address
        assert "script-src 'self'" in answer.headers["content-security-policy"]
        assert "unsafe" not in answer.headers["content-security-policy"]
        assert answer.text.count("<h1>") == 1, address
    for address in (*addresses, "/news.atom", "/tasks/scratch/news.atom", "/tasks/scratch.csv"):
        assert "hidden-4711" not in client.get(address).text, "the season's secret"


@pytest.mark.parametrize("form", ["safetensors", "onnx"])
def test_published_ego_shows_its_training_partners(form: Format, tmp_path: Path) -> None:
    """Its bytes are those that `export` writes; what a changed file says of itself is no proof."""
    ego = load_registry().policy("scratch/ppo-ego-s0-v1/robot")
    assert ego.trained_against is not None
    data = policy_file(ego.id, form, load_registry)
    digest = hashlib.sha256(data).hexdigest()
    changed = hashlib.sha256(data.replace(b"self_play", b"self-play")).hexdigest()
    app = make_app(tmp_path, (Robot("lab", "published", 900.0), Robot("school", "changed", 800.0)))
    database, ids = Database(f"sqlite:///{tmp_path / 'service.db'}"), {}
    with database.write() as connection:
        for method, sha256 in (("published", digest), ("changed", changed)):
            row = {"sha256": sha256, "bytes": len(data), "created_at": 0.0}
            connection.execute(schema.artefacts.insert(), row)
            where = SUBMISSION.method == method
            connection.execute(sa.update(schema.submissions).where(where).values(artefact=sha256))
            ids[method] = connection.execute(sa.select(SUBMISSION.id).where(where)).scalar_one()
    with TestClient(app) as client:
        pages = {method: client.get(f"/submissions/{id}").text for method, id in ids.items()}
    said = {m: re.findall(r"met in training: ([^<]+)", page) for m, page in pages.items()}
    database.close()
    split = ego.trained_against.split
    assert said == {
        "published": [f"the training side of {split}, as the registry says"],
        "changed": ["not known"],
    }


def test_a_hostile_name_stays_a_text(client: TestClient) -> None:
    for address in ("/tasks/scratch", "/tasks/scratch/compare"):
        text = client.get(address).text
        assert "&lt;script&gt;alert(1)&lt;/script&gt;" in text
        assert "{{ 7*7 }}" in text, "a name is no template"
    assert inline(HOSTILE) == ["script", "onerror", "img"], "the planted name would be found"


def test_indistinguishable_methods_share_a_place(client: TestClient) -> None:
    text = client.get("/tasks/scratch").text
    places = re.findall(r'<span class="rank">(\d)', text)
    assert places == ["1", "1", "3", "4"], "rows to measure by have none"
    assert text.index("ppo ego") < text.index("sac ego") < text.index("scripted")
    home = client.get("/").text
    assert re.findall(r'<span class="rank">(\d)', home) == ["1", "1", "3"], "the leaders"
    assert home.count("No method was scored yet") == 4
    assert "<figure>" not in home, "no film was made"
    rows = re.findall(r'<tr role="row" class="reference">(.*?)</tr>', text, re.DOTALL)
    named = zip(("self-play", "random", "zero"), rows, strict=True)
    assert all(name in row for name, row in named)
    assert 'data-label="Normalised">0.00<' in rows[1]


def test_submission_shows_queue_place_or_receipt(
    client: TestClient, submissions: tuple[str, str]
) -> None:
    done, waiting = submissions
    assert "number 1 in the queue" in client.get(waiting).text
    answer = client.get(f"{done}/receipt.json")
    assert answer.headers["content-disposition"].startswith("attachment")
    assert set(answer.json()) == {"content", "signature"}
    assert client.get(f"{waiting}/receipt.json").status_code == 404


def test_partners_are_filtered_by_every_trait(client: TestClient) -> None:
    def count(query: str, task: str = "scratch") -> tuple[int, int]:
        text = client.get(f"/tasks/{task}/partners?{query}").text
        found = re.search(r"(\d+) of (\d+) partners", text)
        assert found
        return int(found[1]), int(found[2])

    assert count("") == (198, 198)
    assert count("algorithm=ippo&disability=d3") == (8, 198)
    assert count("side=test") == (99, 198)
    groups = [count(f"behaviour={letter}")[0] for letter in "ABCDEFGH"]
    assert sum(groups) == 198
    assert count("algorithm=<script>") == (0, 198)
    assert count("", "gentle_feeding") == (200, 200), "of the zoo's persons those of its board"
    assert count("algorithm=ippo", "gentle_feeding") == (0, 200)


def test_person_card_shows_numbers_with_ranges(client: TestClient) -> None:
    assert "person-00000-v1" in client.get("/tasks/gentle_scratch/partners").text
    assert "person-" not in client.get("/tasks/scratch/partners").text
    card = client.get("/partners/gentle_scratch/person-00042-v1").text
    for name, number in described_numbers(person("gentle_scratch", 42)).items():
        row = re.search(rf">{name.replace('_', ' ')}</th>(.*?)</tr>", card, re.DOTALL)
        assert row, name
        shown = re.findall(r'class="number">([^<]*)<', row[1])[:3]
        assert shown == [f"{number[key]:.4g}" for key in ("value", "low", "high")]
    assert person("gentle_scratch", 42).identity in card and "no model of a patient" in card
    assert "person-00041-v1" in card and "person-00043-v1" in card
    for absent in ("person-30000-v1", "person-00042-v2", "person-x"):
        assert client.get(f"/partners/gentle_scratch/{absent}").status_code == 404


def test_two_methods_are_compared_partner_by_partner(client: TestClient) -> None:
    text = client.get("/tasks/scratch/compare").text
    assert text.count('href="/partners/scratch/') == 99
    a = re.findall(r'<option value="(\w+)"', text)[:2]
    forward, back = (
        client.get(f"/tasks/scratch/compare?a={one}&b={other}").text
        for one, other in (a, reversed(a))
    )
    found = [re.search(r"<b>(-?[\d.]+)</b>, 95% interval", page) for page in (forward, back)]
    assert found[0] and found[1] and float(found[0][1]) == -float(found[1][1])
    assert client.get("/tasks/scratch/compare?a=nobody").status_code == 404


def test_the_explorer_has_the_saved_pairs(client: TestClient) -> None:
    numbers = re.search(r'data-numbers="([^"]+)"', client.get(EXPLORER).text)
    assert numbers
    text = client.get(f"{numbers[1]}/matrix.json").text
    axes = json.loads(text, parse_constant=lambda name: pytest.fail(name))
    answer = client.get(f"{numbers[1]}/return.f32")
    assert "immutable" in answer.headers["cache-control"]
    values = np.frombuffer(answer.content, "<f4").reshape(198, 198)
    pairs = pl.read_parquet(PUBLISHED / "scratch" / "pairs.parquet")
    for place in (0, 4711, 39203):
        row = pairs.row(place, named=True)
        r, c = divmod(place, 198)
        assert (axes["rows"][r]["name"], axes["columns"][c]["name"]) == (row["ego"], row["partner"])
        assert values[r, c] == pytest.approx(row["return"])
    for order in axes["orders"].values():
        assert sorted(order["rows"]) == sorted(order["columns"]) == list(range(198))
    assert client.get(f"{numbers[1]}/secret.f32").status_code == 404
    assert client.get("/crossplays/scratch/0123/return.f32").status_code == 404


def test_an_explorer_shows_robots_that_have_no_setting(tmp_path: Path) -> None:
    """Such as egos, which an organiser lets play beside the robots of teams."""
    shutil.copytree(PUBLISHED / "bed_bath", tmp_path / "bed_bath")
    table = tmp_path / "bed_bath" / "pairs.parquet"
    pairs = pl.read_parquet(table)
    ego = pl.col("ego") == pairs["ego"][0]
    pairs.with_columns(
        pl.when(ego).then(None).otherwise(pl.col("ego_disability")).alias("ego_disability")
    ).write_parquet(table)
    read = CrossPlays(tmp_path).of("bed_bath")
    assert read is not None and "–" in read.blocks("disability")[0]


def test_pages_and_static_files_are_cached(client: TestClient) -> None:
    first = client.get(EXPLORER)
    again = client.get(EXPLORER, headers={"If-None-Match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    plain = client.get(EXPLORER, headers={"Accept-Encoding": "identity"})
    assert plain.text == first.text
    address = re.search(r'href="(/static/pages\.[^"]+\.css)"', first.text)
    assert address
    assert "immutable" in client.get(address[1]).headers["cache-control"]
    for absent in ("pages.css", "..%2f__init__.py"):
        assert client.get(f"/static/{absent}").status_code == 404


class Films:
    """Stands for the command line: writes a film and a table, or fails."""

    def __init__(self, fails: bool = False) -> None:
        self.fails = fails
        self.commands: list[Sequence[str]] = []

    def __call__(self, arguments: Sequence[str], folder: Path) -> None:
        self.commands.append(arguments)
        if self.fails:
            raise RuntimeError("no display")
        out = Path(arguments[-1])
        if arguments[0] in ("render", "watch"):
            out.write_bytes({"render": b"film", "watch": b"episode"}[arguments[0]])
        else:
            out.mkdir()
            pl.DataFrame({"episode": [1, 0], "return": [2.0, 1.0]}).write_parquet(
                out / "episodes.parquet"
            )


ONE = Pair("scratch", "scratch/a/robot", "scratch/b/human", ("1" * 64, "2" * 64), 1)


def test_a_film_is_made_once_and_kept(tmp_path: Path) -> None:
    run = Films(fails=True)
    videos = Videos(tmp_path, run)
    assert videos.state(ONE) == "none"
    for fails, state in ((True, "failed"), (False, "ready")):
        run.fails, run.commands = fails, []
        assert videos.ask(ONE) == "waiting"
        videos.ask(ONE)
        videos.wait()
        assert videos.state(ONE) == state
    assert videos.ask(ONE) == "ready"
    assert videos.returns(ONE) == [1.0, 2.0]
    assert [words[0] for words in run.commands] == ["render", "watch", "crossplay"]
    film, episode = Videos(tmp_path, run).film(ONE.key), Videos(tmp_path, run).episode(ONE.key)
    assert film is not None and film.read_bytes() == b"film"
    assert episode is not None and episode.read_bytes() == b"episode"
    episode.unlink()
    assert Videos(tmp_path, run).episode(ONE.key) is None, "of an older version"
    assert [one.name for one in tmp_path.iterdir()] == [ONE.key]


def test_films_have_so_much_room_on_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The one that nobody has looked at for longest goes."""
    pairs = [dataclasses.replace(ONE, env_version=number) for number in range(4)]
    videos = Videos(tmp_path, Films())
    for place, pair in enumerate(pairs[:3]):
        videos.ask(pair)
        videos.wait()
        os.utime(tmp_path / pair.key, (place, place))
    size = sum(path.stat().st_size for path in tmp_path.rglob("*") if path.is_file()) // 3
    monkeypatch.setattr("assistax_board.pages.videos.MOST_BYTES", 3 * size)
    assert videos.film(pairs[0].key)  # somebody looks at the oldest
    videos.ask(pairs[3])
    videos.wait()
    assert [videos.state(pair) for pair in pairs] == ["ready", "none", "ready", "ready"]


@pytest.mark.slow
@pytest.mark.usefixtures("one_window")
def test_pages_and_films_are_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guards, "PAGES", parse("40/minute"))
    monkeypatch.setattr(film_routes, "FILMS", parse("2/hour"))
    monkeypatch.setattr(Videos, "ask", lambda self, pair: "waiting")
    with TestClient(make_app(tmp_path), follow_redirects=False) as reader:
        pairs = [f"/pairs/scratch/ippo-d1-s0-v1/ippo-d{d}-s1-v1" for d in (1, 3, 5)]
        codes = []
        for pair in pairs:
            form = {FIELD: form_token(reader, pair)}
            codes.append(reader.post(pair, data=form).status_code)
        assert codes == [303, 303, 429]
        found = [reader.get("/").status_code for _ in range(40)]
        assert (found[0], found[-1]) == (200, 429)


def test_no_other_file_is_served_as_a_film(tmp_path: Path) -> None:
    (tmp_path / "x").mkdir()
    (tmp_path / "x" / "film.mp4").write_bytes(b"secret")
    videos = Videos(tmp_path, Films())
    for key in ("x", "../x", "", "A" * 32, ".." + "0" * 30):
        assert videos.film(key) is None and videos.episode(key) is None


def test_form_token_is_bound_to_browser(tmp_path: Path) -> None:
    app = make_app(tmp_path)
    with TestClient(app) as reader, TestClient(app) as other:
        form = {FIELD: form_token(reader, PAIR)}
        other.get(PAIR)
        assert reader.post(PAIR).status_code == 403
        assert other.post(PAIR, data=form).status_code == 403
        elsewhere = {"Sec-Fetch-Site": "cross-site"}
        assert reader.post(PAIR, data=form, headers=elsewhere).status_code == 403
        cookie = next(iter(reader.cookies.jar))
        assert cookie.has_nonstandard_attr("HttpOnly")
        assert cookie.get_nonstandard_attr("SameSite") == "strict"


def test_pages_of_another_registry_show_its_partners_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    registry = published(teams_of(2), tmp_path)
    environments = []
    monkeypatch.setattr(subprocess, "run", lambda *_, env, **__: environments.append(env))
    run_command(["list"], tmp_path, registry)
    assert environments[0]["ASSISTAX_ZOO_REGISTRY"] == str(registry)
    with TestClient(make_app(tmp_path, (), registry=registry)) as reader:
        listed = reader.get("/tasks/scratch/partners").text
        assert "ippo-d9-s1-v0" in listed and "-v1" not in listed
        assert reader.get("/partners/scratch/ippo-d9-s1-v0").status_code == 200
        assert reader.get("/partners/scratch/ippo-d1-s0-v1").status_code == 404
        assert reader.get(EXPLORER).status_code == 404
        assert reader.get(PAIR.replace("v1", "v0")).status_code == 200
        assert "explorer" not in reader.get("/tasks/scratch").text


def test_two_hundred_readers_cost_one_rendering() -> None:
    rendered, cache = [], PageCache()

    def render() -> str:
        rendered.append(1)
        time.sleep(0.2)
        return "page"

    with ThreadPoolExecutor(200) as pool:
        list(pool.map(lambda _: cache.page("k", 60.0, render), range(200)))
    assert rendered == [1]


def test_page_cache_expires_and_is_bounded() -> None:
    now, texts = [0.0], iter("abc")
    cache = PageCache(lambda: now[0], most_bytes=1_000_000)

    def page() -> bytes:
        return cache.page("k", 1.0, lambda: next(texts)).body

    assert page() == page() == b"a"
    now[0] = 10.0
    assert page() == b"b"
    for i in range(2000):
        cache.page(str(i), 1.0, lambda: "x")
    assert page() == b"c"
    texts = iter("d")
    cache.page("large", 60.0, lambda: "x" * 999_000)
    assert page() == b"d", "the cache is bounded in bytes"
    for i in range(2000):  # pages of which none can be made
        with pytest.raises(ZeroDivisionError):
            cache.page(f"none {i}", 1.0, lambda: str(1 / 0))
    assert cache.lacks("k")


def test_stale_page_is_served_during_renewal() -> None:
    now, may, done = [0.0], threading.Event(), threading.Event()
    cache = PageCache(lambda: now[0])
    cache.page("k", 1.0, lambda: "old")

    def slow() -> str:
        assert may.wait(10)
        done.set()
        return "new"

    now[0] = 2.0
    assert [cache.page("k", 1.0, slow).body for _ in range(3)] == [b"old"] * 3
    may.set()
    assert done.wait(10)
    while cache.page("k", 1.0, lambda: "newer").body != b"new":
        time.sleep(0.01)


def test_axis_excludes_other_values() -> None:
    axis = axis_over([10.0, 20.0])
    assert 0 < axis.at(10.0) < axis.at(20.0) < axis.width
    assert axis.holds(15.0) and not axis.holds(0.0)
    centred = axis_over([-1.0, 3.0], around=0.0)
    assert centred.at(0.0) == centred.width / 2
    assert axis_over([]).width == axis_over([5.0, 5.0]).width


def test_templates_mark_nothing_as_safe() -> None:
    from assistax_board import pages

    folder = Path(str(pages.__file__)).parent / "templates"
    templates = list(folder.glob("*.html"))
    assert len(templates) > 10
    for one in templates:
        assert not re.search(r"\|\s*safe|autoescape|Markup|tojson", one.read_text()), one.name


def test_a_new_score_costs_its_own_methods_figures(
    service: Service, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[str] = []
    real = boards.unplaced
    monkeypatch.setattr(
        boards, "unplaced", lambda method, panel: made.append(method.name) or real(method, panel)
    )
    kept = boards.Boards(service.queries, CrossPlays(tmp_path), FakeFiles())
    for turn, lab in enumerate(("ada", "bob", "eve")):
        declared(service, new_submitter(service, lab), 1e3 * turn, 1e3 * turn + 1)
        work_off(service)
        board = kept.of(TASK)
        assert board is not None
        assert (len(board.rows), len(made)) == (turn + 1, turn + 1)
        assert [row.place for row, _ in board.rows] == list(range(1, turn + 2))


def test_older_board_is_shown_during_computation(
    service: Service, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = boards.Boards(service.queries, CrossPlays(tmp_path), FakeFiles())

    def rows() -> int:
        board = kept.of(TASK)
        assert board is not None
        return len(board.rows)

    scored(service, new_submitter(service, "ada"), 1.0)
    assert rows() == 1
    go_on, real = threading.Event(), boards.unplaced
    monkeypatch.setattr(behind, "PATIENCE", 0.01)
    monkeypatch.setattr(boards, "unplaced", lambda *args: go_on.wait(60) and real(*args))
    scored(service, new_submitter(service, "bob"), 2.0)
    assert rows() == 1 and kept.is_behind(TASK)
    go_on.set()
    monkeypatch.setattr(behind, "PATIENCE", 60.0)
    assert rows() == 2


def test_gentle_board_shows_violations(service: Service) -> None:
    lab = new_submitter(service)
    for number in range(2):
        scored(service, lab, 1.0, f"r{number}")
    assert "Violations" not in TestClient(create_app(service)).get(f"/tasks/{TASK}").text
    with service.database.write() as connection:
        rows = connection.execute(sa.select(schema.scores).order_by(SCORE.submission)).all()
        for row, violations in zip(rows, (0.1, 0.3), strict=True):
            gentle = {"violations": violations, "caring_success": 0.55, "by_preference": {}}
            gentle |= {"failed_persons": 0.4, "discomfort": 0.1}
            gentle["slopes"] = {"force": {"slope": violations, "slope_ci": None, "within": 0.7}}
            update = sa.update(schema.scores).where(SCORE.submission == row.submission)
            connection.execute(update.values(released=row.released | gentle))
    page = TestClient(create_app(service)).get(f"/tasks/{TASK}").text
    assert 'data-label="Violations">20%<' in page  # of two seeds
    assert 'data-label="Caring success">55%<' in page
    assert 'data-label="Persons failed">40%<' in page
    assert 'data-label="Discomfort">10%<' in page and 'data-label="Slope force">0.20<' in page
    table = TestClient(create_app(service)).get(f"/tasks/{TASK}.csv").text
    assert "caring_success,failed_persons,discomfort,violations,slope_force," in table


def test_submission_page_is_headed_by_its_mean(service: Service) -> None:
    lab = new_submitter(service)
    first = scored(service, lab, 1.0)
    assert "single robot" in TestClient(create_app(service)).get(f"/tasks/{TASK}").text
    scored(service, lab, 4.0, "r2")
    client = TestClient(create_app(service))
    page = client.get(f"/submissions/{first}").text
    tiles = re.findall(r"<dt>([^<]+)</dt><dd>([\d.]+)</dd>", page)
    assert [name for name, _ in tiles[:2]] == ["This robot", "M_test of 2 seeds"]
    means = [float(value) for _, value in tiles[:2]]
    assert means == pytest.approx([1.5, 3.0], abs=0.1)
    assert "2 single robots" in client.get(f"/tasks/{TASK}").text
