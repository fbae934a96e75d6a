"""Write the attack's counts into docs/log/attack.md, between its two markers.

Run from a checkout, as `make attack` does: `python -m tools.attack_table attack.jsonl`.
"""

import json
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

PAGE = Path("docs/log/attack.md")
BEGIN, END = "<!-- counts of make attack: begin -->", "<!-- counts of make attack: end -->"
HEAD = """| family | trials | struck | failures | slowest trial, s | most memory, MiB |
|---|---:|---:|---:|---:|---:|"""


def main(arguments: list[str]) -> int:
    """Write the table of a log; return 1 where it has none of a whole attack."""
    if len(arguments) != 1:
        print("usage: python -m tools.attack_table attack.jsonl", file=sys.stderr)
        return 2
    try:
        text = table(read_log(Path(arguments[0])))
        write(PAGE, text)
    except (OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(PAGE)
    return 0


def read_log(path: Path) -> list[dict[str, Any]]:
    """Return the counts of each family, those of its last run, in the order of the first.

    Raises:
        ValueError: There are none.
    """
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    if not lines:
        raise ValueError(f"{path} has no counts; run `make attack`")
    return list({line["family"]: line for line in lines}.values())


def table(families: Iterable[Mapping[str, Any]]) -> str:
    """Return the table of families, and a sentence with their sums."""
    families = list(families)
    rows = [
        f"| {family['family']} | {family['trials']:,} | {family.get('struck', '')} | "
        f"{family['failures']} | {family['slowest_seconds']:.1f} | {family['most_memory_mib']:,} |"
        for family in families
    ]
    trials, failures = (sum(family[name] for family in families) for name in ("trials", "failures"))
    least = min(family["share"] for family in families)
    part = "" if least == 1 else f" This was no whole attack: a share of {least:g} of the trials."
    sums = f"{trials:,} trials of {len(families)} families, {failures} failures.{part}"
    return "\n".join((HEAD, *rows, "", sums))


def write(page: Path, text: str) -> None:
    """Replace what stands between the markers of a page.

    Raises:
        ValueError: The page does not have each marker once.
    """
    content = page.read_text(encoding="utf-8")
    if (content.count(BEGIN), content.count(END)) != (1, 1):
        raise ValueError(f"{page} needs the lines {BEGIN!r} and {END!r}, each once")
    before, _, rest = content.partition(BEGIN)
    after = rest.partition(END)[2]
    page.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
