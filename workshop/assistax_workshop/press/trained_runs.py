"""Teams of a run folder, with the run's name and the split of egos.

The folder of a `train-ego` run also holds `split.json`, the split whose training side its partners
were.
"""

import dataclasses
from pathlib import Path

from pydantic import ValidationError

from assistax_base.bounded_reading import read_text
from assistax_base.errors import FormatError
from assistax_base.validated import first_problem
from population.runs.folder import DONE, MAX_TEAMS_BYTES, REMEDY, RunFolder
from population.runs.trained import TrainedTeam, read_teams, teams_folder
from zoo.schema import Split
from zoo.splits import check_split


def read_run(folder: Path | str) -> list[TrainedTeam]:
    """Return the teams of a run folder, each with its run's name; an ego also has its split.

    Raises:
        FormatError: `teams.json` or a file it names is missing or malformed.
    """
    teams, home, run = read_teams(folder), teams_folder(folder), Path(folder).resolve().name
    split = _trained_against(home / "split.json", home.parent / "split.json")
    run_folder = RunFolder(home)
    known = run_folder.config().key.get("split") if run_folder.key else None
    if split and known and split["sha256"] != known:
        raise FormatError(
            f"split of the run {folder}", f"sha256 {known}", split["sha256"], REMEDY, DONE
        )
    return [
        dataclasses.replace(
            team,
            training={"run": run, **team.training},
            trained_against=split if team.is_ego else None,
        )
        for team in teams
    ]


def _trained_against(*places: Path) -> dict[str, str] | None:
    """Return id and sha256 of the first split file of `places`; None if there is none."""
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        return None
    try:
        text = read_text(path, MAX_TEAMS_BYTES, FormatError, "split", REMEDY)
        split = Split.model_validate_json(text)
        check_split(split)
    except ValidationError as error:
        raise FormatError(str(path), "a split", first_problem(error), REMEDY, DONE) from None
    return {"split": split.id, "sha256": split.sha256}
