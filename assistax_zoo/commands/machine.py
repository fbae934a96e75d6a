"""Commands over this machine: its installation, and the cache."""

from typing import Annotated

from cyclopts import Parameter

from assistax_zoo.shell.caches import KINDS, Held, chosen_kinds, clean, held
from assistax_zoo.shell.console import answer


def doctor(*, json: bool = False) -> None:
    """Examine this installation: its broken, missing and working parts.

    One line each, problems first; exit code 1 if something is broken. It looks at Python, packages
    and extras, JAX's devices, the compilers, cache, disks, registry, added zoos and the remote, and
    changes nothing.

    Args:
        json: Print JSON.

    Example:
        assistax-zoo doctor
    """
    from assistax_zoo.shell.doctor import examine

    findings = examine()
    broken = sum(finding.state == "broken" for finding in findings)
    lines = [f"{finding.state:7} {finding.topic:10} {finding.text}" for finding in findings]
    content = {"ok": not broken, "findings": [vars(finding) for finding in findings]}
    answer(json, content, *lines, f"{broken} broken" if broken else "nothing is broken")
    if broken:
        raise SystemExit(1)


def cache(*, json: bool = False) -> None:
    """Show the cache's content by kind: place, files and size.

    `assistax-zoo cache clean` removes it.

    Args:
        json: Print JSON.

    Example:
        assistax-zoo cache
    """
    kinds = [held(kind) for kind in KINDS]
    total = sum(kind.bytes for kind in kinds)
    lines = [f"{_amount(kind)}  {kind.folder}" for kind in kinds]
    answer(json, {"kinds": [vars(kind) for kind in kinds], "bytes": total}, *lines)


def clean_cache(
    *,
    what: Annotated[tuple[str, ...], Parameter(negative=())] = (),
    yes: bool = False,
    json: bool = False,
) -> None:
    """Remove cached files; without --yes only say which.

    Added zoos, your own partners and settings are not part of the cache and stay. Registries of
    remotes are removed only with --what registries.

    Args:
        what: Kind to remove: shards, registries, references, xla or fused; repeat it for more.
        yes: Remove them.
        json: Print JSON.

    Example:
        assistax-zoo cache clean --what xla --what references --yes
    """
    results = [clean(kind) if yes else (held(kind), []) for kind in chosen_kinds(what)]
    shown, busy = [kind for kind, _ in results], [path for _, paths in results for path in paths]
    total = sum(kind.bytes for kind in shown)
    lines = [f"{_amount(kind)}  {kind.what}" for kind in shown]
    lines += [f"kept, another process writes to it: {path}" for path in busy]
    done = "removed" if yes else "add --yes to remove"
    content = {"removed": yes, "kinds": [vars(kind) for kind in shown], "bytes": total}
    answer(json, {**content, "busy": busy}, *lines, f"{done} {total / 1e6:.1f} MB")


def _amount(kind: Held) -> str:
    return f"{kind.kind:10} {kind.bytes / 1e6:9.1f} MB {kind.files:6} files"
