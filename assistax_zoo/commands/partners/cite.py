"""The command that prints citations of the parts that were used."""

from pathlib import Path

from assistax_base.digest import sha256
from assistax_base.errors import printable
from assistax_zoo.commands.options import Source
from assistax_zoo.shell.console import answer
from evaluation.figures.summary import read_summary
from evaluation.record.manifest import read_manifest
from evaluation.record.verification import strange_tables_refused
from zoo.history.official import is_official
from zoo.lock import read_lock
from zoo.namespaces import plain_name
from zoo.registry import Registry, load_registry

PAPER = """@inproceedings{hinckeldey2025assistax,
  title = {Assistax: A Hardware-Accelerated Reinforcement Learning Benchmark for
    Assistive Robotics},
  author = {Hinckeldey, Leonard and Fosong, Elliot and Miller, Elle and Rubavicius, Rimvydas and
    McInroe, Trevor and Wollstadt, Patricia and Wiebel-Herboth, Christiane B. and
    Ramamoorthy, Subramanian and Albrecht, Stefano V.},
  booktitle = {2nd Coordination and Cooperation in Multi-Agent Reinforcement Learning Workshop},
  year = {2025},
  eprint = {2507.21638},
  archivePrefix = {arXiv},
  url = {https://arxiv.org/abs/2507.21638}
}"""


DOI: str = ""  # of this software in CITATION.cff, once there is one


def cite(
    folder: Path | None = None,
    /,
    *,
    release: str | None = None,
    source: Source = Source(),
    json: bool = False,
) -> None:
    """Print BibTeX of the paper, of this software, and of the partners that were used.

    The partners' entry names their release, its root, the splits, and the registry's sha256: with
    these a reader gets the same bytes. With --lock it names what the lock pins, with a folder what
    its result used. Releases of other zoos are cited by the authors, title and address that they
    were published with.

    Args:
        folder: Folder of a result.
        release: Release of the partners; default the lock's, else the newest.
        source: Where policies come from.
        json: Print JSON.

    Example:
        assistax-zoo cite results/ego >> paper.bib
    """
    registry = load_registry(source.registry)
    if folder and (release or source.lock):
        raise ValueError(f"{folder} says what was used; leave out the release and the lock")
    entries = {
        "paper": PAPER,
        "software": _software(registry.data.releases[registry.release].date[:4]),
        "partners": _used(registry, folder)
        if folder
        else _partners(registry, release, source.lock),
    }
    answer(json, entries, "\n\n".join(entries.values()))


def _software(year: str) -> str:
    from assistax_zoo.shell.main import _version

    doi = f",\n  doi = {{{DOI}}}" if DOI else ""
    return f"""@software{{assistax_zoo,
  title = {{assistax-zoo: Pretrained Partners for Assistive Robots, and Their Evaluation}},
  author = {{{{The assistax-zoo authors}}}},
  year = {{{year}}},
  version = {{{_version().partition(":")[0]}}},
  license = {{Apache-2.0}}{doi}
}}"""


def _partners(registry: Registry, release: str | None, lock: Path | None) -> str:
    """Return the entry of the partners that were used."""
    pinned = read_lock(lock) if lock else None
    name = release or (pinned.release if pinned else registry.release)
    if name not in registry.data.releases:
        registry.select(release=name)  # which refuses it
    published = registry.data.releases[name]
    part, plain = registry.part_of(name)
    splits, facts = published.splits.values(), [f"root {registry.root(name)}"]
    if pinned and lock:
        if pinned.release != name:
            raise ValueError(f"{lock} pins release {pinned.release}, not {name}; drop --release")
        splits = [split.id for split in pinned.splits.values()]
        facts = [f"root {pinned.root}", f"lock {pinned.sha256}"]
    facts += [f"registry {sha256(part.path.read_bytes())}"]
    facts += [f"split {plain_name(split)}" for split in sorted(splits)]
    return _entry(part, plain, name, facts)


def _used(registry: Registry, folder: Path) -> str:
    """Return the entries of the partners that a finished result used, by its manifest."""
    summary, manifest = read_summary(folder), read_manifest(folder) or {}
    with strange_tables_refused(folder):
        roots = {str(name): root for name, root in manifest["registry"]["roots"].items()}
    if not roots:
        raise ValueError(f"{folder} has no partners or robots of a zoo, so there is none to cite")
    entries = []
    for name, root in sorted(roots.items()):
        part, plain = registry.part_of(name)
        if plain not in part.data.releases or registry.root(name) != root:
            raise ValueError(
                f"{folder} used release {name} with root {root}, which the registry in use does "
                "not have; name the registry that it was made with"
            )
        facts = [f"root {root}", f"{summary.task} in version {summary.env_version}"]
        facts += [f"split {plain_name(summary.split.id)}"] if summary.split else []
        facts += [f"lock {summary.lock}"] if summary.lock else []
        facts.append(f"result {manifest['sha256']}")
        entries.append(_entry(part, plain, name, facts))
    return "\n\n".join(entries)


def _entry(part: Registry, plain: str, name: str, facts: list[str]) -> str:
    """Return the entry of a release.

    Args:
        part: Registry of its zoo.
        plain: Its name there.
        name: The same with the zoo's namespace.
        facts: Text of its note.
    """
    published = part.data.releases[plain]
    fields = {"title": f"assistax-zoo Partners, Release {plain}", **_authorship(part, plain)}
    fields |= {"year": published.date[:4], "note": "; ".join(map(_bare, facts))}
    lines = ",\n".join(f"  {field} = {{{value}}}" for field, value in fields.items())
    unnamed = "" if "author" in fields else f"% release {name} names no authors: ask its makers\n"
    key = "_".join(filter(None, ("assistax_zoo", *name.split(":"))))
    return f"{unnamed}@misc{{{key},\n{lines}\n}}"


def _authorship(registry: Registry, release: str) -> dict[str, str]:
    """Return title, authors and address of a release, as far as it names them."""
    citation = registry.data.releases[release].citation
    if citation is None:
        return {"author": "{The assistax-zoo authors}"} if is_official(registry.data) else {}
    fields = {"title": citation.title, "author": " and ".join(citation.authors)}
    return {name: _plain(value) for name, value in fields.items() if value} | (
        {"url": citation.url} if citation.url else {}
    )


def _bare(text: str) -> str:
    """Return text without braces and backslashes, which would end a field of BibTeX."""
    return printable(text).translate(str.maketrans("", "", "{}\\"))


def _plain(text: str) -> str:
    """Return text with the special characters of BibTeX and TeX removed."""
    kept = printable(text).translate(str.maketrans("", "", "{}\\$%#^~"))
    return kept.replace("&", "\\&").replace("_", "\\_")
