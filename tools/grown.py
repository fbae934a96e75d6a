"""Check of registry.json against all earlier states in Git: published entries never change.

    python -m tools.grown

Exit code 1 if an entry that an earlier state published is gone or changed, other than by a
withdrawal of its whole release. A shallow clone has few earlier states, or none, which is said.
"""

import json
import subprocess
from pathlib import Path

from assistax_base.errors import ImmutableError
from zoo.history.merkle import with_roots
from zoo.registry import load_registry, parse_registry
from zoo.saving import check_grown
from zoo.schema import SCHEMA_VERSION, RegistryFile

FILE = "registry.json"
# Root of v3's first state, of 25 November 2026, which held persons of environment version 2 alone.
REWRITTEN = {"a17b63d52e153ac7b9e8ba2536f0dda1fc478fc20de35009ac456c007b6c0d16"}
# Releases that left the repository before the package was released, and the last commit that has
# them whole, see docs/stability.md. Their names are never taken again.
WITHDRAWN = dict.fromkeys(("v0", "v2"), "42ab08cd938f3114e7dd6038d3ef5fc2e6f5eb29")


def earlier_states(folder: Path) -> dict[str, RegistryFile]:
    """Return the registries of Git's commits before HEAD, by commit, newest first."""
    # The newest commit that changed it is HEAD itself, or has what the parent has.
    commits = _git(folder, "rev-list", "HEAD", "--skip=1", "--", FILE).split()
    parent = _git(folder, "rev-parse", "--verify", "--quiet", "HEAD^").split()
    states = {}
    for commit in dict.fromkeys([*parent, *commits]):
        text = _git(folder, "show", f"{commit}:{FILE}")
        if text:  # a commit before there was one, or that removed it
            states[commit] = parse_state(text, f"{FILE} of {commit[:12]}")
    return states


def parse_state(text: str, source: str) -> RegistryFile:
    """Return an earlier state's registry; schema 1 is converted to today's.

    Schema 1 had no roots, and called the interval of self-play's mean `ci`.
    """
    data = json.loads(text)
    if data["schema_version"] != 1:
        return parse_registry(text, source)
    for team in data["teams"].values():
        if figures := team.get("self_play"):
            figures["mean_ci"] = figures.pop("ci")
    return with_roots(parse_registry(json.dumps(data | {"schema_version": SCHEMA_VERSION}), source))


def check(new: RegistryFile, states: dict[str, RegistryFile]) -> list[str]:
    """Return one problem for each earlier state that lost something.

    A withdrawn release may be missing, but only as a whole. The known rewriting of v3 is no loss.
    """
    problems = []
    missing = WITHDRAWN.keys() - new.releases.keys()
    for commit, old in states.items():
        releases = {
            name: release
            for name, release in old.releases.items()
            if name not in missing and release.root not in REWRITTEN
        }
        try:
            check_grown(old.model_copy(update={"releases": releases}), new)
        except ImmutableError as error:
            problems.append(f"since {commit[:12]}: {error}")
    return problems


def main(folder: Path = Path(__file__).parents[1]) -> int:
    """Print the verdict and return the exit code."""
    states = earlier_states(folder)
    if not states:
        print(f"no earlier {FILE} in this clone: nothing to hold it against")
        return 0
    problems = check(load_registry(folder / FILE, roots=False).data, states)
    for problem in problems:
        print(problem)
    print(f"{FILE} held against {len(states)} earlier states: {len(problems)} problems")
    return 1 if problems else 0


def _git(folder: Path, *words: str) -> str:
    """Return git's output; "" if the command fails, as for an unknown commit."""
    done = subprocess.run(["git", *words], cwd=folder, capture_output=True, text=True)
    return done.stdout if done.returncode == 0 else ""


if __name__ == "__main__":
    raise SystemExit(main())
