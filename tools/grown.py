"""Check of registry.json against its states in Git since version 1.0: published entries stay.

    python -m tools.grown

Exit code 1 if an entry that an earlier state published is gone or changed. Before version 1.0 of
the package nothing was published, so states of earlier versions do not count. A shallow clone has
few earlier states, or none, which is said.
"""

import subprocess
import tomllib
from pathlib import Path

from assistax_base.errors import ImmutableError
from zoo.registry import load_registry, parse_registry
from zoo.saving import check_grown
from zoo.schema import RegistryFile

FILE, PROJECT = "registry.json", "pyproject.toml"


def published_states(folder: Path) -> dict[str, RegistryFile]:
    """Return the registries of Git's commits since 1.0 before HEAD, by commit, newest first."""
    # The newest commit that changed it is HEAD itself, or has what the parent has.
    commits = _git(folder, "rev-list", "HEAD", "--skip=1", "--", FILE).split()
    parent = _git(folder, "rev-parse", "--verify", "--quiet", "HEAD^").split()
    states = {}
    for commit in dict.fromkeys([*parent, *commits]):
        text = _git(folder, "show", f"{commit}:{FILE}")
        if text and _released(_git(folder, "show", f"{commit}:{PROJECT}")):
            states[commit] = parse_registry(text, f"{FILE} of {commit[:12]}")
    return states


def _released(project: str) -> bool:
    """Return whether a project file is of version 1.0 or a later one."""
    version = tomllib.loads(project).get("project", {}).get("version", "0")
    return int(version.partition(".")[0]) >= 1


def check(new: RegistryFile, states: dict[str, RegistryFile]) -> list[str]:
    """Return one problem for each earlier state that lost something."""
    problems = []
    for commit, old in states.items():
        try:
            check_grown(old, new)
        except ImmutableError as error:
            problems.append(f"since {commit[:12]}: {error}")
    return problems


def main(folder: Path = Path(__file__).parents[1]) -> int:
    """Print the verdict and return the exit code."""
    states = published_states(folder)
    if not states:
        print(f"no earlier {FILE} of version 1.0 or later in this clone: nothing to compare with")
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
