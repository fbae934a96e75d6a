"""The folder of a run: its configuration, its metrics, and the teams it made.

Metrics, checkpoints and teams hold the run's key, the digest of its configuration. Those of another
run are refused.

- `config.json`: configuration and environment
- `checkpoints/`: training state by number of updates
- `metrics.parquet`: one row for each update and member
- `snapshots/`: the teams by number of updates, if they were asked for
- `teams.json`: the teams, once the run is finished
- `robot.safetensors`, `human.safetensors`: their parameters, stacked: leaves [P, ...] named by
'/'-joined path
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import safetensors.numpy

from assistax_base.bounded_reading import parse_json, read_text
from assistax_base.digest import json_sha256
from assistax_base.errors import FormatError, shorten
from assistax_base.files import METADATA_KEY, atomic_write, write_json
from assistax_base.parquet import check_readable, read_metadata, read_parquet, write_parquet
from assistax_envs.preferences import WIDTH
from population.config import Member, TrainConfig
from population.hyperparameters import DAggerConfig, PPOConfig, TrainerConfig
from population.networks.spec import PolicySpec
from population.networks.stack import flatten

MAX_TEAMS_BYTES = 16 * 1024 * 1024
REMEDY = "give the folder that training wrote, after the run has finished"
DONE = "nothing was read"
# Metrics that are means over finished episodes; so are the reward terms.
OF_EPISODES = ("return", "success", "violated")
# Fields that may change when a run is resumed; "steps" may too, with `extends`.
_MAY_CHANGE = ("checkpoint_every", "self_play_episodes")
_DIGESTS = {  # descriptions of fields that are digests
    "config.key.partners": "its partners have other parameters or settings",
    "config.key.split": "its split has other content",
    "environment.scene": "the task has another scene",
}
_SCHEMA = {
    "update": pl.Int64,
    "steps": pl.Int64,
    "seconds": pl.Float64,
    "member": pl.Int64,
    "disability": pl.String,
}
_SCHEMA |= {"seed": pl.Int64, "episodes": pl.Int64, "nonfinite": pl.Int64}


class RunFolder:
    """Reader and writer of a run's folder; readers see a file wholly or not at all."""

    def __init__(self, folder: Path | str, key: str | None = None) -> None:
        """Set the paths of the folder's files.

        Args:
            folder: The folder.
            key: The run's key, for a folder without a configuration of its own.
        """
        self.folder, self._key = Path(folder), key
        self.checkpoints = self.folder / "checkpoints"
        self.teams = self.folder / "teams.json"
        self.snapshots = self.folder / "snapshots"
        self._config = self.folder / "config.json"
        self._metrics = self.folder / "metrics.parquet"

    def open(self, config: TrainConfig, environment: Mapping[str, Any], resume: bool) -> None:
        """Create the folder, or check that it holds a run of the same configuration.

        Args:
            config: The run's configuration.
            environment: Facts that a resumed run must share: version and backend.
            resume: Whether to resume a run that is there.

        Raises:
            ValueError: It holds another run, or it holds one and `resume` is false.
            OSError: It cannot be written.
        """
        content = {"config": config.to_json(), "environment": dict(environment)}
        if not self._config.exists():
            if self.folder.exists() and (not self.folder.is_dir() or any(self.folder.iterdir())):
                raise ValueError(
                    f"{self.folder} exists and is not the folder of a run; choose an empty or new "
                    "folder"
                )
            self.folder.mkdir(parents=True, exist_ok=True)
        elif not resume:
            raise ValueError(
                f"{self.folder} already holds a run; resume it, or choose a new folder"
            )
        else:
            # Read by this version, so that hyperparameters the run lacks have their defaults.
            existing = {**self._read_config(), "config": self.config().to_json()}
            may_change = (*_MAY_CHANGE, *(("steps",) if extends(config.trainer) else ()))
            if changed := differences(existing, content, may_change):
                raise ValueError(
                    f"{self.folder} holds a run with another configuration: {changed}; "
                    "repeat that configuration to resume it, or choose a new folder"
                )
        write_json(self._config, content)

    def snapshot(self, update: int) -> "RunFolder":
        """Return the folder of the teams after `update` updates."""
        return RunFolder(self.snapshots / f"{update:09d}", self.key)

    @property
    def key(self) -> str | None:
        """Digest of configuration, environment and partners; None without a configuration.

        Fields that may change when a run is resumed are left out.
        """
        if self._key is not None or not self._config.exists():
            return self._key
        extended = ("steps",) if extends(self.config().trainer) else ()
        return self._digest_without(*_MAY_CHANGE, *extended)

    @property
    def recipe(self) -> str | None:
        """Digest as `key` without the members, which runs of other seeds share; None like `key`."""
        return self._digest_without(*_MAY_CHANGE, "members") if self._config.exists() else None

    def finished(self, config: TrainConfig) -> bool:
        """Return whether the folder holds the teams of this run, trained to its end."""
        if not self.teams.exists():
            return False
        try:
            steps = self.team_items()[0]["training"]["steps"]
        except (FormatError, KeyError, TypeError) as error:
            raise ValueError(
                f"{self.teams} is damaged ({type(error).__name__}: {error}); delete it, then the "
                "same command writes it again"
            ) from None
        return steps == config.updates * config.trainer.batch_steps

    def team_items(self) -> list[Any]:
        """Return the items of `teams.json`, one for each team, whose content is not checked.

        Raises:
            FormatError: It is missing, too large, or not a list of at least one team.
        """
        text = read_text(self.teams, MAX_TEAMS_BYTES, FormatError, "teams", REMEDY)
        try:
            items, problem = parse_json(text), ""
        except (ValueError, RecursionError) as error:
            items, problem = None, f"{type(error).__name__}: {error}"
        if isinstance(items, list) and items:
            return items
        expected = "a JSON list of at least one team"
        raise FormatError(str(self.teams), expected, problem or shorten(items), REMEDY, DONE)

    def config(self) -> TrainConfig:
        """Return the configuration of the run in this folder."""
        content = self._read_config()
        try:
            return TrainConfig.from_json(dict(content["config"]))
        except (LookupError, TypeError, ValueError, AttributeError) as error:
            raise ValueError(
                f"{self._config} is damaged ({type(error).__name__}: {error}); choose a new folder"
            ) from None

    def read_metrics(self, until: int) -> pl.DataFrame:
        """Return the metrics of the first `until` updates.

        Raises:
            ValueError: The file is damaged, or of another run.
        """
        check_readable([self._metrics])
        table = read_parquet(self._metrics)
        metadata = parse_json(read_metadata(self._metrics).get(METADATA_KEY, "{}"))
        if (metadata.get("run") if isinstance(metadata, dict) else None) != self.key:
            raise ValueError(
                f"{self._metrics} is of another run than {self._config.name} beside it; take the "
                "folder from where it was made, or start a new run in another folder"
            )
        if not isinstance(table.schema.get("update"), pl.Int64):
            raise ValueError(f"{self._metrics} is damaged; start a new run in another folder")
        return table.filter(pl.col("update") <= until)

    def write_metrics(self, metrics: pl.DataFrame) -> None:
        """Replace the metrics."""
        metadata = {METADATA_KEY: json.dumps({"run": self.key})}
        write_parquet(metrics, self._metrics, metadata=metadata)

    def write_teams(
        self,
        config: TrainConfig,
        specs: Mapping[str, PolicySpec],
        params: Mapping[str, Any],
        training: Mapping[str, Any],
        self_play: Sequence[Mapping[str, Any] | None],
    ) -> None:
        """Write the parameters [M, ...] by role, then `teams.json`, which ends the run."""
        for role, spec in specs.items():
            metadata = {"spec": spec.to_json(), "rows": list(config.names), "run": self.key}
            text = json.dumps(metadata, sort_keys=True, separators=(",", ":"))
            leaves = dict(sorted(flatten(params[role]).items()))
            atomic_write(
                self.folder / f"{role}.safetensors",
                safetensors.numpy.save(leaves, {METADATA_KEY: text}),
            )
        teams = [
            {
                "team": {
                    "task": config.task,
                    "algorithm": config.algorithm,
                    "disability": member.disability,
                    "seed": member.seed,
                },
                "roles": {
                    role: {"spec": spec.to_json(), "file": f"{role}.safetensors", "row": row}
                    for role, spec in specs.items()
                },
                "training": dict(training),
                "self_play": result,
                "run": self.key,
            }
            for row, (member, result) in enumerate(zip(config.members, self_play, strict=True))
        ]
        write_json(self.teams, teams)

    def _digest_without(self, *names: str) -> str:
        """Return the digest of the configuration without the fields of these names."""
        content = {**self._read_config(), "config": self.config().to_json()}
        return json_sha256(_without(content, names))

    def _read_config(self) -> dict[str, Any]:
        """Return the JSON object of `config.json`."""
        try:
            return parse_json(self._config.read_text(encoding="utf-8"))
        except (ValueError, RecursionError) as error:
            raise ValueError(f"{self._config} is not JSON ({error}); choose a new folder") from None


def extends(trainer: TrainerConfig) -> bool:
    """Return whether a longer run may continue a finished one of this trainer.

    It may if the length sets no learning rate, entropy bonus, replay size, student's share or
    width of liking.
    """
    if isinstance(trainer, DAggerConfig):
        return not trainer.anneal_lr
    if not isinstance(trainer, PPOConfig) or trainer.liking_width > WIDTH:
        return False
    return not (trainer.anneal_lr or trainer.anneal_entropy or trainer.student_share)


def metrics_table(
    metrics: Mapping[str, Any],
    members: Sequence[Member],
    done: int,
    batch_steps: int,
    seconds: float,
) -> pl.DataFrame:
    """Return one row for each update and member.

    Args:
        metrics: Values [U, M] by name, of U updates.
        members: The M members.
        done: Updates before these.
        batch_steps: Environment steps of one member in one update.
        seconds: Training time at the end of these updates.
    """
    columns = {name: np.asarray(value) for name, value in metrics.items()}
    updates, count = next(iter(columns.values())).shape
    update = np.repeat(done + 1 + np.arange(updates), count)
    table = pl.DataFrame(
        {
            "update": update,
            "steps": update * batch_steps,
            "seconds": np.full(updates * count, seconds),
            "member": np.tile(np.arange(count), updates),
            "disability": [member.disability for member in members] * updates,
            "seed": [member.seed for member in members] * updates,
            **{name: value.reshape(-1) for name, value in sorted(columns.items())},
        }
    )
    # A mean over no episodes is missing, not a number.
    means = [name for name in columns if name in OF_EPISODES or name.startswith("term_")]
    table = table.with_columns(pl.col(name).fill_nan(None) for name in means)
    return table.cast({name: dtype for name, dtype in _SCHEMA.items() if name in table.columns})


def differences(there: Any, here: Any, ignored: Sequence[str] = _MAY_CHANGE, path: str = "") -> str:
    """Return a description of the fields in which two JSON values differ; "" if they are equal."""
    if isinstance(there, Mapping) and isinstance(here, Mapping):
        parts = [
            differences(
                there.get(name), here.get(name), ignored, f"{path}.{name}" if path else name
            )
            for name in dict.fromkeys([*there, *here])
            if name not in ignored
        ]
        return "; ".join(part for part in parts if part)
    if json.dumps(there) == json.dumps(here):
        return ""
    if path in _DIGESTS:
        return f"{_DIGESTS[path]} ({_short(there)} there, {_short(here)} here)"
    return f"{path.removeprefix('config.')} is {_short(there)} there and {_short(here)} here"


def _without(value: Any, names: Sequence[str]) -> Any:
    """Return a JSON value without the fields of these names, at any depth."""
    if isinstance(value, Mapping):
        return {name: _without(part, names) for name, part in value.items() if name not in names}
    return [_without(part, names) for part in value] if isinstance(value, list) else value


def _short(value: Any) -> str:
    """Return a JSON value's text, cut to 60 characters."""
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
