"""Publication of teams: shards first, the registry last; published bytes never change.

Teams that a release lacks go into new shards; existing shards and ids stay unchanged. A shard left
behind by a killed publication is in no registry, hence invisible, and the next publication replaces
it.
"""

import datetime
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from assistax_base.digest import sha256
from assistax_base.errors import ImmutableError, PublishError, listing
from assistax_base.files import atomic_write, exclusive
from assistax_envs.registered import track_of
from assistax_envs.versions import VERSIONS
from assistax_workshop.press.candidates import Candidate, Check, make_candidate
from assistax_workshop.press.release import completed, signed
from population.networks.spec import PolicySpec, Role
from population.runs.trained import TrainedTeam
from zoo.ids import check_name, same_team
from zoo.locations import shard_root
from zoo.parameters.encoding import check_params, encode_shard
from zoo.partners.person_tables import described
from zoo.registry import Registry, load_registry
from zoo.saving import save_registry, writable_registry
from zoo.schema import (
    SCHEMA_VERSION,
    Citation,
    Ego,
    PolicyRow,
    RegistryFile,
    Release,
    Shard,
    Team,
    Training,
)
from zoo.verify import installed_settings


def publish(
    teams: Sequence[TrainedTeam],
    registry_path: Path | str,
    release: str,
    *,
    persons: Sequence[str] = (),
    environments: Mapping[str, int] | None = None,
    date: str | None = None,
    description: str = "",
    citation: Citation | None = None,
    complete: bool = True,
    check: Check = check_params,
    key: Path | None = None,
) -> Registry:
    """Add teams and egos to a release, with shards and the default split; return the registry.

    Publishing the same bytes again changes nothing. A release that grows over days is published
    with `complete` false: its teams can be listed, fetched and played, but the default release and
    its splits stay until `assistax_workshop.press.release.complete_release`.

    Args:
        teams: Trained teams; `assistax_workshop.press.trained_runs.read_run` reads them from a run
            folder.
        registry_path: The registry; it is created if it does not exist. Shards go to `zoo/shards`
            beside it.
        release: Release that they join, such as "v0"; it is created if it does not exist.
        persons: Tasks whose persons join the release too.
        environments: Environment version of each task; default the installed ones.
        date: ISO date of a new release; today if not given.
        description: Description of a new release, in one sentence.
        citation: Citation of the release; a later one replaces an earlier one.
        complete: Whether the release is complete with these teams.
        check: Called with spec, leaves and policy id; raises if the parameters do not fit the spec.
        key: Ed25519 private key, PEM, by which the release is signed.

    Raises:
        ImmutableError: An id, a figure or an environment version that is already published would
            change.
        PublishError: A team lacks provenance, occurs twice, or has the parameters of another; or
            the registry is official, or there is nothing to publish.
        ValueError: A task of `persons` has no persons.
    """
    path = Path(registry_path)
    writable_registry(path)
    check_name("release", release)
    created = Release(date=_day(date), description=description, environments={}, citation=citation)
    candidates = [make_candidate(team, release, check) for team in teams]
    with exclusive(path):
        old = load_registry(path) if path.exists() else None
        base = old.data if old else _empty(release, created)
        fresh = _fresh(base, candidates) if candidates or not persons else []
        if old and not fresh and not key and not citation and not persons:
            return old
        data = _with_release(base, release, created, fresh, persons, environments or VERSIONS)
        if old and not fresh and not key and data == old.data:
            return old
        _check_sizes(data, release, fresh)
        data, files = _with_members(data, release, fresh)
        data = completed(data, release) if complete else data
        return _write(signed(data, release, key) if key else data, files, path)


def _day(date: str | None) -> str:
    """Return an ISO date; today if `date` is empty."""
    try:
        return (datetime.date.fromisoformat(date) if date else datetime.date.today()).isoformat()
    except ValueError as error:
        raise PublishError(
            "date of the release", "an ISO date such as 2027-01-31", f"{date!r} ({error})"
        ) from None


def _empty(release: str, created: Release) -> RegistryFile:
    """Return the content of a registry with one empty release."""
    return RegistryFile(
        schema_version=SCHEMA_VERSION,
        release=release,
        releases={release: created},
        disability_settings=installed_settings(),
        runs={},
        shards={},
        teams={},
    )


def _fresh(data: RegistryFile, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the unpublished candidates, in order; refuse changes of published ones."""
    if not candidates:
        raise PublishError("publication", "at least one team", "none")
    owners = {
        (role, row.sha256): team
        for team, entry in data.members.items()
        for role, row in entry.policies.items()
    }
    fresh: dict[str, Candidate] = {}
    for candidate in sorted(candidates, key=lambda candidate: candidate.team.order):
        name = str(candidate.team)
        if name in data.members:
            _check_unchanged(name, data.members[name], candidate)
            continue
        if name in fresh:
            raise PublishError(f"team {name}", "each team once", "it is given twice")
        for role, digest in candidate.hashes.items():
            other = owners.setdefault((role, digest), name)
            if not same_team(other, name):
                raise PublishError(
                    f"parameters of {name}/{role}",
                    "parameters of its own",
                    f"those of {other}/{role}",
                )
        fresh[name] = candidate
    return list(fresh.values())


def _check_unchanged(name: str, published: Team | Ego, candidate: Candidate) -> None:
    """Refuse a candidate whose hashes or figures differ from those published under its name."""
    hashes = {role: row.sha256 for role, row in published.policies.items()}
    if hashes != candidate.hashes:
        raise ImmutableError(
            f"team {name}", f"the published sha256 {hashes}", f"{dict(candidate.hashes)}"
        )
    for field in ("self_play", "trained_against"):
        before, now = getattr(published, field, None), getattr(candidate, field)
        if now not in (None, before):
            raise ImmutableError(
                f"{field.replace('_', '-')} of {name}", f"the published {before}", f"{now}"
            )


def _with_release(
    data: RegistryFile,
    release: str,
    created: Release,
    fresh: Sequence[Candidate],
    persons: Sequence[str],
    environments: Mapping[str, int],
) -> RegistryFile:
    """Return the registry with the release, its persons and new tasks' environment versions."""
    if data.disability_settings != installed_settings():
        installed = f"{installed_settings()} in the installed environments"
        raise ImmutableError(
            "disability settings", f"the registry's {data.disability_settings}", installed
        )
    entry = data.releases.get(release, created)
    versions = dict(entry.environments)
    members = [(c.team.task, str(c.team), c.training.env_version) for c in fresh]
    for task, member, trained in (*members, *((task, "", None) for task in persons)):
        if task not in environments:
            raise PublishError(
                f"task {task}",
                f"one of {listing(environments)}",
                "a task without environment version",
            )
        if environments[task] != versions.setdefault(task, environments[task]):
            expected = f"version {versions[task]} of {task}, as release {release} has it"
            raise ImmutableError(f"release {release}", expected, f"version {environments[task]}")
        if trained not in (None, versions[task]):
            raise PublishError(
                f"team {member}",
                f"training on {task} version {versions[task]}",
                f"on {trained}",
            )
    now = {
        "environments": dict(sorted(versions.items())),
        "persons": {**entry.persons, **{task: described(task) for task in persons}},
        "citation": created.citation or entry.citation,
    }
    releases = {**data.releases, release: entry.model_copy(update=now)}
    return data.model_copy(update={"releases": releases})


def _check_sizes(data: RegistryFile, release: str, fresh: Sequence[Candidate]) -> None:
    """Refuse policies whose sizes differ from those of the task's others in this environment."""
    versions = data.releases[release].environments
    known = {
        (shard.task, shard.role): (shard.spec.observation_size, shard.spec.action_size)
        for shard in data.shards.values()
        if data.releases[shard.release].environments[shard.task] == versions.get(shard.task)
    }
    for candidate in fresh:
        for role, spec in candidate.specs.items():
            sizes = spec.observation_size, spec.action_size
            expected = known.setdefault((candidate.team.task, role), sizes)
            if sizes != expected:
                raise PublishError(
                    f"policy {candidate.team}/{role}",
                    "{} observations and {} actions, as the task's others have".format(*expected),
                    "{} and {}".format(*sizes),
                )


def _with_members(
    data: RegistryFile, release: str, fresh: Sequence[Candidate]
) -> tuple[RegistryFile, dict[str, bytes]]:
    """Return the registry with the new teams and egos, and the bytes of their shards by path."""
    runs, shards, files = dict(data.runs), dict(data.shards), {}
    rows: dict[tuple[str, Role], PolicyRow] = {}
    for (task, algorithm, role, spec), members in _by_shard(fresh):
        stem = f"zoo/shards/{track_of(task)}/{task}-{algorithm}-{role}-{spec.digest}"
        path = _free_path(stem, shards)
        content, hashes = encode_shard(
            spec, [(f"{member.team}/{role}", member.leaves[role]) for member in members]
        )
        files[path] = content
        shards[path] = Shard(
            sha256=sha256(content),
            bytes=len(content),
            task=task,
            algorithm=algorithm,
            role=role,
            release=release,
            rows=len(members),
            spec=spec,
        )
        for row, (member, digest) in enumerate(zip(members, hashes, strict=True)):
            rows[str(member.team), role] = PolicyRow(shard=path, row=row, sha256=digest)
    members = dict(data.members)
    for candidate in fresh:
        name, run = str(candidate.team), _run_key(runs, candidate)
        runs[run] = candidate.training
        policies = {role: rows[name, role] for role in sorted(candidate.specs, reverse=True)}
        members[name] = candidate.entry(run, policies)
    tables = {
        "teams": {name: entry for name, entry in members.items() if isinstance(entry, Team)},
        "egos": {name: entry for name, entry in members.items() if isinstance(entry, Ego)},
    }
    return data.model_copy(update={"runs": runs, "shards": shards, **tables}), files


def _by_shard(
    fresh: Iterable[Candidate],
) -> list[tuple[tuple[str, str, Role, PolicySpec], list[Candidate]]]:
    """Return the teams of each new shard, by task, algorithm, role and spec, sorted."""
    groups: dict[tuple[str, str, Role, PolicySpec], list[Candidate]] = {}
    for candidate in fresh:
        for role, spec in candidate.specs.items():
            groups.setdefault(
                (candidate.team.task, candidate.team.algorithm, role, spec), []
            ).append(candidate)
    return sorted(groups.items(), key=lambda group: (*group[0][:3], group[0][3].digest))


def _free_path(stem: str, taken: Mapping[str, Shard]) -> str:
    """Return the first path of a shard, numbered if needed, that is not taken."""
    number = 1
    while (
        path := f"{stem}.safetensors" if number == 1 else f"{stem}-{number}.safetensors"
    ) in taken:
        number += 1
    return path


def _run_key(runs: Mapping[str, Training], candidate: Candidate) -> str:
    """Return the run's name, with a digest if another provenance has that name."""
    if runs.get(candidate.run, candidate.training) == candidate.training:
        return candidate.run
    return f"{candidate.run}-{sha256(candidate.training.model_dump_json().encode())[:8]}"


def _write(data: RegistryFile, files: Mapping[str, bytes], path: Path) -> Registry:
    """Write the shards, then the registry; on failure delete the shards. Return the registry."""
    written: list[Path] = []
    try:
        for name, content in files.items():
            written.append(shard_root(path) / name)
            atomic_write(written[-1], content)
        return save_registry(data, path)
    # Before an Exception the registry is not replaced. An interrupt may come after, so it deletes
    # nothing: unlisted shards are harmless.
    except Exception:
        for file in written:
            file.unlink(missing_ok=True)
        raise
