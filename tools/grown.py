"""Check of registry.json against all earlier states in Git: published entries never change.

    python -m tools.grown

Exit code 1 if an entry that an earlier state published is gone or changed. A shallow clone has few
earlier states, or none, which is said.
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
# Roots of v2 before its teams were trained anew under their ids, see docs/releases.md.
REWRITTEN = {
    "3e2274eebe2edfc64c395829e326c111536d6c50a601cbfbaf2ce9006c6bea57",
    "f776afbece8d160d4319b5c14ee1cd3849947ff4395f70d5541a74beccb3639e",
    "32ed4ee94510d47d02026a6be9639cd977f28946c1b722f57bf9fc432a4d47f8",
    "49092792063f67e81e4d3a4854b3a6934a2bc18ccad6170cf77a2ae19630a166",
    "a17b63d52e153ac7b9e8ba2536f0dda1fc478fc20de35009ac456c007b6c0d16",
}


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
    """Return messages for entries that earlier states lost, without the known rewriting of v2."""
    problems = []
    for commit, old in states.items():
        kept = {
            name: release for name, release in old.releases.items() if release.root not in REWRITTEN
        }
        try:
            check_grown(old.model_copy(update={"releases": kept}), new)
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
