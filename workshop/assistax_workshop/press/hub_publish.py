"""Publication to a folder or a hub; on a hub it is one commit and a tag, seen wholly or not."""

import contextlib
import dataclasses
import functools
import tempfile
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

from huggingface_hub import CommitOperationAdd, HfApi, constants
from huggingface_hub.errors import HfHubHTTPError

from assistax_base.errors import (
    MissingFileError,
    MissingRepositoryError,
    PublishError,
    ZooError,
    counted,
    shorten,
)
from assistax_base.files import atomic_write
from assistax_workshop.press.croissant import FILE, croissant
from assistax_workshop.press.model_card import MARK, card_license, model_card
from assistax_workshop.press.publish import publish
from population.runs.trained import TrainedTeam
from zoo.registry import MAX_REGISTRY_BYTES, Registry, load_registry
from zoo.transport.addresses import open_remote
from zoo.transport.hub import HubRemote, hub_errors
from zoo.transport.remotes import TransientError, read_file, with_retries

MAX_CARD_BYTES = 1024 * 1024
FILMS = (".gif", ".webp", ".mp4")


@dataclasses.dataclass(frozen=True)
class Publication:
    """Result of a publication."""

    registry: str
    release: str
    added: tuple[str, ...]  # policy ids
    policies: int
    commit: str | None = None  # of a hub
    tag: str | None = None


def publish_to(
    teams: Sequence[TrainedTeam],
    to: str,
    release: str,
    *,
    license: str = "",
    film: Path | None = None,
    **arguments: Any,
) -> Publication:
    """Publish teams and egos to a folder or a hub repository; return the result.

    Args:
        teams: Trained teams, or robots that `train-ego` trained.
        to: A folder, or `hf://org/name`, which is made if it does not exist; or a registry.json,
            beside which no card is written.
        release: Release that they join.
        license: Licence of the policies, for the card; see `model_card`.
        film: .gif, .webp or .mp4 that the card shows; it is published beside it.
        **arguments: `date`, `description` and the others of
        `assistax_workshop.press.publish.publish`.

    Raises:
        PublishError: The teams are refused, or there was another publication meanwhile.
        RemoteError: The hub cannot be reached, or does not let this user write.
    """
    shown = _Shown(license, film)
    if not to.startswith("hf://"):
        if "://" in to:
            raise PublishError(
                f"remote {shorten(to)}",
                "a folder or hf://org/name",
                "a remote that can only be read",
                "use one",
            )
        return _publish_to_folder(teams, Path(to), release, shown, **arguments)
    remote = open_remote(to)
    assert isinstance(remote, HubRemote)
    if remote.ref != "main":
        raise PublishError(
            to,
            "hf://org/name, whose newest state is extended",
            f"revision {remote.ref}",
            "leave it out",
        )
    return _publish_to_hub(teams, remote, release, shown, **arguments)


class _Shown:
    """Licence and film of a card, which the registry lacks."""

    def __init__(self, license: str, film: Path | None) -> None:
        if film is not None and film.suffix.lower() not in FILMS:
            raise ValueError(f"{film.name} is no film; allowed are {', '.join(FILMS)}")
        self.license = license
        self.files = {f"film{film.suffix.lower()}": film.read_bytes()} if film else {}

    def texts(self, registry: Registry, name: str, before: str, url: str = "") -> dict[str, bytes]:
        """Return the files that describe a remote, by name; the card last."""
        card = model_card(registry, name, self.license, next(iter(self.files), ""), before)
        return {
            FILE: croissant(registry, name, card_license(card), url),
            "README.md": card.encode(),
        }


def _publish_to_folder(
    teams: Sequence[TrainedTeam], to: Path, release: str, shown: _Shown, **arguments: Any
) -> Publication:
    """Publish to a folder with the layout of a remote, the card last; or to a registry alone."""
    path = to if to.suffix == ".json" else to / "registry.json"
    before = _ids(path)
    registry = publish(teams, path, release, **arguments)
    card = to / "README.md"
    text = card.read_text("utf-8", errors="replace") if card.exists() else ""
    if to != path and (not card.exists() or MARK in text):
        texts = shown.texts(registry, to.resolve().name, text)
        for name, data in {**shown.files, **texts}.items():
            atomic_write(to / name, data)
    added = tuple(entry.id for entry in registry.policies if entry.id not in before)
    return Publication(str(path), release, added, len(registry.policies))


def _publish_to_hub(
    teams: Sequence[TrainedTeam],
    remote: HubRemote,
    release: str,
    shown: _Shown,
    **arguments: Any,
) -> Publication:
    """Publish to a hub repository by one commit and a tag."""
    api = HfApi(endpoint=constants.ENDPOINT, library_name="assistax-zoo")
    with tempfile.TemporaryDirectory(prefix="assistax-zoo-") as temporary:
        path = Path(temporary) / "registry.json"
        _create(api, remote)
        published = _read_optional(remote, "registry.json", MAX_REGISTRY_BYTES)
        if published is not None:
            path.write_bytes(published)
        before = _ids(path)
        registry = publish(teams, path, release, **arguments)
        added = tuple(entry.id for entry in registry.policies if entry.id not in before)
        commit = remote.revision
        if path.read_bytes() != published or shown.files or shown.license:
            commit = _commit(api, remote, _files(remote, registry, shown), release, len(added))
        tag = _tag(api, remote, release, commit)
    return Publication(f"{remote.name}@{tag}", release, added, len(registry.policies), commit, tag)


def _create(api: Any, remote: HubRemote) -> None:
    """Create the repository if there is none; `remote.revision` is then the commit to build on."""
    try:
        remote.revision  # noqa: B018  asks the hub
    except MissingRepositoryError:

        def create() -> None:
            with _hub(remote, "make the repository"):
                api.create_repo(remote.repo, exist_ok=True)

        with_retries(create, remote.name)


def _read_optional(remote: HubRemote, path: str, limit: int) -> bytes | None:
    """Return a remote's file, or None if there is none."""
    try:
        return read_file(remote, path, limit)
    except MissingFileError:
        return None


def _files(remote: HubRemote, registry: Registry, shown: _Shown) -> dict[str, bytes]:
    """Return the files of the commit: new shards, the registry, and the card if it is ours."""
    root = registry.path.parent
    files = {
        shard: (root / shard).read_bytes()
        for shard in registry.data.shards
        if (root / shard).is_file()
    }
    files["registry.json"] = registry.path.read_bytes()
    card = _read_optional(remote, "README.md", MAX_CARD_BYTES)
    if card is None or MARK.encode() in card:
        before = (card or b"").decode(errors="replace")
        url = f"{constants.ENDPOINT}/{remote.repo}"
        files |= {**shown.files, **shown.texts(registry, remote.repo, before, url)}
    return files


def _commit(api: Any, remote: HubRemote, files: dict[str, bytes], release: str, added: int) -> str:
    """Make the commit once, even after a lost answer; return its id."""

    def commit() -> str:
        try:
            with _hub(remote, "commit"):
                return api.create_commit(
                    remote.repo,
                    [CommitOperationAdd(path, data) for path, data in files.items()],
                    commit_message=f"Release {release}: {counted(added, 'policy')}",
                    parent_commit=remote.revision,
                ).oid
        except (TransientError, _ConflictError) as error:
            head = HubRemote(remote.name, remote.repo, remote.ref)
            if _read_optional(head, "registry.json", MAX_REGISTRY_BYTES) == files["registry.json"]:
                return head.revision
            if isinstance(error, TransientError) and head.revision == remote.revision:
                raise
            expected = f"commit {remote.revision} as its newest"
            newest = f"{head.revision}: somebody published meanwhile"
            raise PublishError(remote.name, expected, newest, "publish again") from None

    advice = "publish again; what was sent is not visible"
    refuse = functools.partial(PublishError, remote.name, "a commit", next_step=advice)
    return with_retries(commit, remote.name, refuse=refuse)


def _tag(api: Any, remote: HubRemote, release: str, commit: str) -> str:
    """Tag the commit `v1`, or later states of the release `v1.1`, ...; return the tag."""

    def tag() -> str:
        with _hub(remote, "tag"):
            tags = {ref.name: ref.target_commit for ref in api.list_repo_refs(remote.repo).tags}
            mine = [
                name for name in tags if tags[name] == commit and name.partition(".")[0] == release
            ]
            if mine:
                return mine[0]
            names = [release, *(f"{release}.{number}" for number in range(1, len(tags) + 2))]
            name = next(name for name in names if name not in tags)
            api.create_tag(remote.repo, tag=name, revision=commit)
            return name

    return with_retries(
        tag, f"tag of {remote.name}; commit {commit} is published, publishing again adds the tag"
    )


class _ConflictError(Exception):
    """The repository's newest commit is not the one that the publication builds on."""


@contextlib.contextmanager
def _hub(remote: HubRemote, deed: str) -> Generator[None]:
    """Convert errors of a writing call to `PublishError`, `TransientError` or a conflict."""
    try:
        with hub_errors(remote):
            try:
                yield
            except HfHubHTTPError as error:
                if error.response.status_code in (409, 412):
                    raise _ConflictError from None
                raise
            except RuntimeError as error:  # how the client reports a failed upload
                cause = error.__cause__
                raise (cause if isinstance(cause, Exception) else error) from None
    except (ZooError, TransientError, _ConflictError):
        raise
    except ValueError as error:  # the client or the hub refuses the call
        raise PublishError(
            remote.name, f"to {deed}", shorten(str(error)), "correct what it names"
        ) from None


def _ids(path: Path) -> set[str]:
    """Return the policy ids of a registry file; empty if there is none."""
    return {entry.id for entry in load_registry(path).policies} if path.exists() else set()
