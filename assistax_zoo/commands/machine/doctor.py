"""The command that says what of an installation is broken or missing."""

from assistax_zoo.shell.console import answer


def doctor(*, json: bool = False) -> None:
    """Examine this installation: what is broken, what is missing, and what works.

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
