"""Completion of a release: default splits and signature."""

from pathlib import Path

from assistax_base.files import exclusive
from zoo.history.merkle import release_root
from zoo.history.signing import sign
from zoo.ids import parse_team, release_number
from zoo.registry import Registry, load_registry
from zoo.saving import save_registry
from zoo.schema import RegistryFile
from zoo.splits import competent, partner_teams
from zoo.splitting.create import leaves_out, with_defaults
from zoo.splitting.rules import half_side, make_split


def complete_release(registry_path: Path | str, release: str, default: bool = True) -> Registry:
    """Give a release that was published in parts its default splits; return the registry.

    Args:
        registry_path: The registry.
        release: The release, which is complete now.
        default: Whether it becomes the default release, unless it is older.
    """
    path = Path(registry_path)
    with exclusive(path):
        registry = load_registry(path)
        data = completed(registry.data, release, default)
        return registry if data == registry.data else save_registry(data, path)


def completed(data: RegistryFile, release: str, default: bool = True) -> RegistryFile:
    """Return the registry with the release's default splits; see `complete_release`."""
    newest = max(data.release, release if default else data.release, key=release_number)
    return _with_default_splits(data.model_copy(update={"release": newest}), release)


def signed(data: RegistryFile, release: str, key: Path) -> RegistryFile:
    """Return the registry with a signature of the release's present content."""
    root = release_root(data, release)
    fields = {"root": root, "signature": sign(release, root, key)}
    entry = data.releases[release].model_copy(update=fields)
    return data.model_copy(update={"releases": {**data.releases, release: entry}})


def _with_default_splits(data: RegistryFile, release: str) -> RegistryFile:
    """Return the registry with a default split, `half` of seed 0, if both halves have teams.

    A split that no longer covers the release stays in the registry; the default moves on to the new
    one, unless it was chosen by hand. A task with persons has their split as its default.
    """
    splits, halves = {split.id: split for split in data.splits}, {}
    for task in data.releases[release].environments.keys() - data.releases[release].persons.keys():
        partners = partner_teams(data, task, release)
        if leaves_out(task):
            partners = competent(data, partners, {})
        if len({half_side(parse_team(team)) for team in partners}) == 2:
            split = make_split(partners, task=task, release=release)
            splits[split.id], halves[task] = split, split.id
    chosen = {
        task: split
        for task, split in data.releases[release].splits.items()
        if not split.startswith(f"{task}/half-s0-{release}-")
    }
    grown = data.model_copy(update={"splits": tuple(splits.values())})
    return with_defaults(grown, release, {**halves, **chosen})
