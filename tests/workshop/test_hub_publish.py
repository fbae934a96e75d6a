import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import yaml

import assistax_workshop.press.hub_publish
from assistax_base.errors import ImmutableError, OfflineError, PublishError, RemoteError
from assistax_workshop.press.hub_publish import Publication, publish_to
from population.runs.trained import TrainedTeam
from tests.zoo.hub_server import Fault, Hub
from zoo.transport.addresses import open_remote
from zoo.transport.fetch import fetch, remote_registry
from zoo.verify import verify

ROOT = Path(__file__).parents[2]
ZOO = "hf://org/zoo"
COMMITS = "POST /api/models/org/zoo/commit/"

# The client's own upload of large files, without its extension module.
pytestmark = pytest.mark.filterwarnings("ignore:Use 'content=:DeprecationWarning")


def put(
    teams: list[TrainedTeam], to: str = ZOO, release: str = "v0", **arguments: Any
) -> Publication:
    """Publish without asking JAX for the leaves of each spec."""
    return publish_to(
        teams, to, release, date="2027-01-31", check=lambda spec, leaves, source: None, **arguments
    )


def files(hub: Hub, revision: str = "main") -> dict[str, bytes]:
    repository = hub.repositories["org/zoo"]
    commit = repository.resolve(revision)
    assert commit is not None
    return repository.commits[commit]


def fetched_and_verified(name: str = ZOO) -> int:
    remote = open_remote(name)
    registry = remote_registry(remote, lambda changes: True)
    fetch(registry, registry.policies, remote)
    report = verify(registry)
    assert report.ok, report.problems
    return report.policies


@pytest.mark.parametrize("mode", ["regular", "lfs"])
def test_one_commit_then_a_tag(mode: str, hub: Hub, cache: Path, teams) -> None:
    hub.upload_mode = mode
    hub.faults = [Fault("POST .*/tag/", status=503)]
    with pytest.raises(RemoteError, match="is published, publishing again adds the tag"):
        put(teams())
    hub.faults = []
    done = put(teams())
    assert (done.tag, done.policies, done.registry) == ("v0", 16, "hf://org/zoo@v0")
    repository = hub.repositories["org/zoo"]
    assert len(repository.commits) == 2 and repository.tags == {"v0": done.commit}
    assert len(hub.large) == (2 if mode == "lfs" else 0)
    assert {Path(name).suffix for name in files(hub)} == {"", ".json", ".md", ".safetensors"}
    assert fetched_and_verified() == fetched_and_verified(done.registry) == 16
    again = put(teams())
    assert (again.commit, again.tag, again.added) == (done.commit, "v0", ())
    assert hub.count(COMMITS) == 1


def test_a_growing_release_gets_another_tag(hub: Hub, cache: Path, teams) -> None:
    first = put(teams())
    before = files(hub)
    grown = put(teams(seeds=range(6)))
    assert (grown.tag, len(grown.added)) == ("v0.1", 8)
    assert hub.repositories["org/zoo"].tags == {"v0": first.commit, "v0.1": grown.commit}
    assert all(
        files(hub)[name] == data for name, data in before.items() if name.endswith(".safetensors")
    )
    assert put(teams(("mappo",)), release="v1").tag == "v1"
    assert (fetched_and_verified(), fetched_and_verified("hf://org/zoo@v0")) == (40, 16)


def test_the_card_has_results_as_evaluation_entries(hub: Hub, cache: Path, teams) -> None:
    from huggingface_hub import ModelCard, ModelCardData

    put(teams())
    card = ModelCard(files(hub)["README.md"].decode())
    assert isinstance(card.data, ModelCardData) and card.data.library_name == "assistax-zoo"
    entries = card.data.eval_results or []
    assert [(entry.dataset_name, entry.metric_type, entry.metric_value) for entry in entries] == [
        ("scratch, disability setting d1", "mean_reward", 950.5),
        ("scratch, disability setting d9", "mean_reward", 950.5),
    ]
    assert "| scratch | ippo | d9 | 4 | 950.5 |" in card.text


def test_card_keeps_licence_and_film(hub: Hub, cache: Path, teams, tmp_path: Path) -> None:
    from huggingface_hub import ModelCard

    (tmp_path / "lift.webp").write_bytes(b"film")
    for to in (ZOO, str(tmp_path / "zoo")):
        put(teams(), to, license="cc-by-4.0", film=tmp_path / "lift.webp")
        put(teams(seeds=range(6)), to)
    published = files(hub)
    written = {
        path.name: path.read_bytes() for path in (tmp_path / "zoo").iterdir() if path.is_file()
    }
    for place in (published, written):
        card = ModelCard(place["README.md"].decode())
        assert card.data.to_dict()["license"] == "cc-by-4.0"
        assert card.data.to_dict()["pipeline_tag"] == "reinforcement-learning"
        assert "](film.webp)" in card.text and place["film.webp"] == b"film"
    (tmp_path / "zoo" / "README.md").write_text("# ours\n")
    hub.put("org/zoo", tmp_path / "zoo")
    for to in (ZOO, str(tmp_path / "zoo")):
        put(teams(("mappo",)), to)
    assert files(hub)["README.md"] == (tmp_path / "zoo" / "README.md").read_bytes() == b"# ours\n"
    with pytest.raises(ValueError, match=r"lift\.txt is no film; allowed are .gif, .webp, .mp4"):
        put(teams(), film=tmp_path / "lift.txt")


def test_a_folder_has_the_layout_of_a_hub(hub: Hub, cache: Path, teams, tmp_path: Path) -> None:
    put(teams())
    done = put(teams(), str(tmp_path / "zoo"))
    assert done.registry == str(tmp_path / "zoo" / "registry.json")
    for name, data in files(hub).items():
        if name.endswith((".safetensors", "registry.json")):  # texts have the remote's name
            assert (tmp_path / "zoo" / name).read_bytes() == data
    metadata = yaml.safe_load((tmp_path / "zoo" / "README.md").read_text().split("---")[1])
    assert metadata["model-index"][0]["name"] == "zoo"
    put(teams(seeds=range(6)), str(tmp_path / "zoo"))
    assert "| v0 | 2027-01-31 | 24 |" in (tmp_path / "zoo" / "README.md").read_text()
    assert fetched_and_verified(str(tmp_path / "zoo")) == 24


def test_published_bytes_never_change(hub: Hub, cache: Path, teams, team) -> None:
    put(teams())
    changed = {role: {**p, "log_std": p["log_std"] + 1} for role, p in team().params.items()}
    with pytest.raises(ImmutableError, match="scratch/ippo-d1-s0-v0"):
        put([team(params=changed)])
    assert hub.count(COMMITS) == 1


@pytest.mark.slow
def test_two_publishers_do_not_overwrite_each_other(
    hub: Hub, cache: Path, teams, monkeypatch
) -> None:
    put(teams())
    real = assistax_workshop.press.hub_publish.publish

    def slow(*words: Any, **arguments: Any) -> Any:
        monkeypatch.setattr(assistax_workshop.press.hub_publish, "publish", real)
        put(teams(("mappo",)))
        return real(*words, **arguments)

    monkeypatch.setattr(assistax_workshop.press.hub_publish, "publish", slow)
    with pytest.raises(PublishError, match="somebody published meanwhile; nothing was published"):
        put(teams(("isac",)))
    assert put(teams(("isac",))).policies == 48
    assert fetched_and_verified() == 48


def test_a_lost_answer_is_looked_up(hub: Hub, cache: Path, teams) -> None:
    routes = COMMITS, "POST .*/tag/"
    hub.faults = [Fault(route, lose_answer=True, times=1) for route in routes]
    assert put(teams()).tag == "v0"
    repository = hub.repositories["org/zoo"]
    assert (len(repository.commits), len(repository.tags)) == (2, 1)


@pytest.mark.slow_for("POST")
@pytest.mark.parametrize(
    "route", ["POST .*/repos/create", COMMITS, "POST .*/preupload/", "POST .*/tag/", "PUT /lfs/"]
)
def test_a_busy_hub_is_asked_again(route: str, hub: Hub, cache: Path, teams, monkeypatch) -> None:
    # The library sleeps between attempts, and has no option for it.
    monkeypatch.setattr("huggingface_hub.utils._http.time.sleep", lambda seconds: None)
    hub.upload_mode = "lfs"
    hub.faults = [Fault(route, status=503, times=2)]
    assert put(teams()).tag == "v0" and fetched_and_verified() == 16


def test_a_hub_that_stays_busy_shows_nothing_new(hub: Hub, cache: Path, teams) -> None:
    put(teams())
    before = files(hub)
    hub.faults = [Fault(COMMITS, status=503)]
    with pytest.raises(PublishError, match="status 503, 3 times; nothing was published"):
        put(teams(("mappo",)))
    assert files(hub) == before


@pytest.mark.parametrize("route", ["PUT /lfs/", COMMITS])
@pytest.mark.slow
def test_a_publication_that_is_killed(route: str, hub: Hub, cache: Path, teams) -> None:
    put(teams())
    before = files(hub)
    hub.upload_mode = "lfs"
    hub.faults = [Fault(route, pause=60, status=503 if route == COMMITS else None)]
    code = (
        "from tests.zoo.conftest import trained_teams\n"
        "from tests.workshop.test_hub_publish import put\n"
        "put(trained_teams(('mappo',)))"
    )
    environment = {**os.environ, "HF_ENDPOINT": hub.url, "HF_HUB_DISABLE_XET": "1"}
    requests = hub.count(route)
    with subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, env=environment) as process:
        deadline = time.monotonic() + 60
        while hub.count(route) == requests:
            assert time.monotonic() < deadline and process.poll() is None
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
    assert files(hub) == before and fetched_and_verified() == 16
    hub.faults = []
    assert put(teams(("mappo",))).tag == "v0.1" and fetched_and_verified() == 32


def test_wrong_places_are_refused(
    hub: Hub, cache: Path, teams, tmp_path: Path, monkeypatch
) -> None:
    from huggingface_hub import constants

    hub.put("org/data", tmp_path, kind="dataset")
    with pytest.raises(RemoteError, match="expected a model repository, found a dataset"):
        put(teams(), "hf://org/data")
    with pytest.raises(PublishError, match="found revision v0"):
        put(teams(), "hf://org/zoo@v0")
    with pytest.raises(PublishError, match="can only be read"):
        put(teams(), f"{hub.url}/zoo")
    hub.faults = [Fault("POST .*/repos/create", status=403)]
    with pytest.raises(RemoteError, match="hf auth login"):
        put(teams(), "hf://org/closed")
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    with pytest.raises(OfflineError, match="offline mode"):
        put(teams())
    assert set(hub.repositories) == {"org/data"}
