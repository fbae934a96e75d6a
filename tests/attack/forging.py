"""A competent forger: changes a finished folder, draws its figures anew and seals it anew."""

import copy
import dataclasses
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars as pl

from evaluation.cast.egos import read_egos
from evaluation.cast.met_partners import MetPartners, met_partners
from evaluation.figures import saved_tables as derived
from evaluation.figures.normalised import COLUMN, bounds_table
from evaluation.figures.summary import Context, EvaluationSummary, read_summary
from evaluation.play.jobs import episode_seeds
from evaluation.record import manifest as provenance
from evaluation.record import tables
from evaluation.record.columns import term_columns
from evaluation.record.record import Record
from zoo.registry import Registry


@dataclasses.dataclass
class Forger:
    """One folder, under change; `close` writes it consistently."""

    folder: Path
    registry: Registry
    rng: random.Random
    better: Path  # an honest evaluation of other robots with the same partners

    def __post_init__(self) -> None:
        self.manifest = copy.deepcopy(provenance.read_manifest(self.folder) or {})
        self.identity: dict[str, Any] = self.manifest["identity"]
        self.table = tables.read_episodes(self.folder / tables.EPISODES_FILE)
        summary = read_summary(self.folder)
        names = [field.name for field in dataclasses.fields(Context)]
        self.context = Context(**{name: getattr(summary, name) for name in names})
        self.is_crossplay = not isinstance(summary, EvaluationSummary)
        path = self.folder / tables.REFERENCES_FILE
        self.references = tables.read_parquet(path) if path.is_file() else None

    def close(self, met: MetPartners | None = None) -> None:
        """Draw every figure from the forged episodes, and write hashes that fit.

        `met` says whom the robots met where their names cannot be looked up.
        """
        met = met or self.met()
        tables.write_episodes(self.table, self.folder / tables.EPISODES_FILE)
        if self.is_crossplay:
            derived.save_crossplay(Record(self.table, self.folder), self.context, met)
        else:
            played = self.references
            drawn = None if played is None else (played, bounds_table(played))
            options = {"references": drawn, "met": met}
            derived.save_evaluation(Record(self.table, self.folder), self.context, **options)
        self.seal()

    def met(self) -> MetPartners:
        """Return whom the robots that the folder names now met in training."""
        names = [row[0] for row in self.identity["egos"]]
        egos = read_egos(names, self.registry, self.identity["task"])
        return met_partners(
            egos, [self.registry.policy(row[0]) for row in self.identity["partners"]]
        )

    def seal(self) -> None:
        """Write a manifest that fits the identity and the files."""
        self.manifest["job"] = provenance.identity_digest(self.identity)
        provenance.write_manifest(self.folder, self.manifest)
        provenance.seal(self.folder)

    def change(self, function: Callable[[pl.DataFrame], pl.DataFrame]) -> None:
        """Change the episodes, and those of the references if there are any."""
        self.table = function(self.table)
        if self.references is not None:
            self.references = function(self.references)

    def rename(self, name: str, digest: str, **described: Any) -> None:
        """Give the first robot another name; columns that describe it are as given, or empty."""
        mine = self.identity["egos"][0][0]
        self.identity["egos"][0] = [name, digest]
        described, is_mine = {"ego": name, **described}, pl.col("ego") == mine
        self.table = self.table.with_columns(
            pl.when(is_mine)
            .then(pl.lit(described.get(column), kind))
            .otherwise(pl.col(column))
            .alias(column)
            for column, kind in self.table.schema.items()
            if column.startswith("ego")
        )
        if self.references is not None:
            self.references = self.references.with_columns(pl.col("ego").replace(mine, name))

    def gain(self, rows: list[int], points: float) -> None:
        """Raise the returns of some episodes, and one of their parts."""
        gain = pl.int_range(pl.len()).is_in(rows).cast(pl.Float32) * points
        names = ["return", next(iter(term_columns(self.table)))]
        self.table = self.table.with_columns(pl.col(name) + gain for name in names)

    def any_of(self, column: str) -> str:
        """Return one of a column's values."""
        return self.rng.choice(sorted(set(self.table[column])))

    def scale(self, rows: pl.Expr, factor: float) -> None:
        """Multiply the returns of rows and all their parts, so that they still add up."""
        names = ["return", "discounted_return", *term_columns(self.table)]
        for name in names:
            value = pl.when(rows).then(pl.col(name) * factor).otherwise(pl.col(name))
            self.table = self.table.with_columns(value.cast(pl.Float32).alias(name))

    def with_keys(self, table: pl.DataFrame) -> pl.DataFrame:
        """Return a table with the keys that the identity gives its episodes."""
        seed, apart = self.identity["seed"], self.identity["apart"]
        rows = table.select("partner", "episode").iter_rows()
        keys = [
            episode_seeds(seed, [episode], partner if apart else None)[0]
            for partner, episode in rows
        ]
        return table.with_columns(pl.Series("key", keys, pl.Int64))

    def measured(self) -> list[str]:
        """Return the columns that come of playing."""
        first = self.table.columns.index("key") + 1
        return self.table.columns[first:]


def scores(forger: Forger) -> None:
    """Raise or lower the returns of a robot, a partner or some episodes."""
    column = forger.rng.choice(("ego", "partner", "episode"))
    rows = pl.col(column) == forger.any_of(column)
    forger.scale(rows, forger.rng.choice((0.5, 0.95, 1.001, 1.000001, 1.05, 2.0)))
    forger.close()


def one_episode(forger: Forger) -> None:
    """Change one episode, as of a tile that is hoped not to be played."""
    row = forger.rng.randrange(forger.table.height)
    name = forger.rng.choice([*forger.measured()])
    column = forger.table[name]
    values = column.to_list()
    values[row] = not values[row] if column.dtype == pl.Boolean else values[row] + 1
    forger.table = forger.table.with_columns(pl.Series(name, values, column.dtype))
    forger.close()


def sides(forger: Forger) -> None:
    """Call training partners test partners."""
    other = {"train": "test", "test": "train"}
    for row in forger.identity["partners"]:
        row[2] = other[row[2]]
    named = pl.col("side").replace(other).alias("side")
    forger.change(lambda table: table.with_columns(named))
    forger.close()


def field(forger: Forger) -> None:
    """Change one field of the summary alone."""
    path = forger.folder / tables.SUMMARY_FILE
    content = tables.read_json(path)
    places = list(_numbers(content))
    node, name = forger.rng.choice(places)
    value = node[name]
    node[name] = value + 1 if type(value) is int else value * 1.01 + 0.1
    tables.write_json(content, path)
    forger.seal()


def table_only(forger: Forger) -> None:
    """Change a table that is drawn from the episodes, and nothing else."""
    names = [tables.PARTNERS_FILE, tables.PROFILE_FILE, tables.BOUNDS_FILE, tables.PAIRS_FILE]
    there = [name for name in names if (forger.folder / name).is_file()]
    path = forger.folder / forger.rng.choice(there)
    table = tables.read_parquet(path)
    floats = [
        name
        for name, kind in table.schema.items()
        if kind.is_float() and table[name].null_count() < table.height and table[name].sum()
    ]
    name = forger.rng.choice(floats)
    tables.write_parquet(table.with_columns(pl.col(name) * 1.02 + 0.01), path)
    forger.seal()


def partner_dropped(forger: Forger, count: int = 1) -> None:
    """Leave out the partners with whom the robots earn least."""
    means = forger.table.group_by("partner").agg(pl.col("return").mean()).sort("return")
    worst = means["partner"].to_list()[:count]
    forger.identity["partners"] = [
        row for row in forger.identity["partners"] if row[0] not in worst
    ]
    forger.change(lambda table: table.filter(~pl.col("partner").is_in(worst)))
    forger.close()


def split_narrowed(forger: Forger) -> None:
    """Leave out the worst third of the partners."""
    partner_dropped(forger, forger.table["partner"].n_unique() // 3)


def partner_repeated(forger: Forger) -> None:
    """Give one partner the episodes of another."""
    first, second = forger.rng.sample(sorted(set(forger.table["partner"])), 2)
    source = forger.table.filter(pl.col("partner") == first).select(
        "ego", "episode", *forger.measured()
    )
    mine = forger.table.filter(pl.col("partner") == second).drop(forger.measured())
    mine = mine.join(source, on=["ego", "episode"], maintain_order="left")
    rows = forger.table.with_row_index("row").filter(pl.col("partner") == second)["row"]
    whole = forger.table.with_row_index("row").filter(pl.col("partner") != second)
    mine = mine.with_columns(rows).select(whole.columns)
    forger.table = pl.concat([whole, mine]).sort("row").drop("row")
    forger.close()


def robot_renamed(forger: Forger) -> None:
    """Say that another published robot played."""
    mine = [row[0] for row in forger.identity["egos"]]
    first = forger.registry.policy(mine[0])
    others = [
        entry
        for entry in forger.registry.policies
        if (entry.role, entry.task, entry.release) == ("robot", first.task, first.release)
        and entry.spec == first.spec
        and entry.id not in mine
    ]
    other = forger.rng.choice(others[:2])  # of few, so that few jobs are played
    forger.rename(
        other.id,
        other.sha256,
        ego_team=other.team,
        ego_algorithm=other.algorithm,
        ego_disability=other.disability if other.setting is not None else None,
        ego_seed=other.seed,
    )
    forger.close()


MARKER = "a-received-folder-ran-code"  # a file that such code makes


def outside_names(place: Path) -> dict[str, str]:
    """Return names of robots that a reader must neither run nor read, with a word for each."""
    secret = place / "secret.safetensors"
    return {
        "function": f"python:subprocess:getoutput?cmd=touch {place / MARKER}",
        "file": f"python:{place / 'evil.py'}:make",
        "absolute": str(secret),
        "upwards": "../../../../../../../../secret.safetensors",
        "model": f"onnx:{place / 'secret.onnx'}",
    }


def rename_robot(forger: Forger, name: str) -> None:
    """Give the first robot a name from outside, without resolving it here."""
    code = f"from pathlib import Path\nPath({str(forger.folder.parent / MARKER)!r}).touch()\n"
    (forger.folder.parent / "evil.py").write_text(f"{code}make = None\n")
    met = forger.met()
    forger.rename(name, "0" * 64)
    forger.close(met)


def better_episodes(forger: Forger) -> None:
    """Take the episodes that other robots played."""
    other = tables.read_episodes(forger.better / tables.EPISODES_FILE)
    rows = forger.rng.sample(range(forger.table.height), forger.rng.randint(1, 30))
    chosen = pl.int_range(pl.len()).is_in(rows)
    forger.table = forger.table.with_columns(
        pl.when(chosen).then(other[name]).otherwise(pl.col(name)).alias(name)
        for name in forger.measured()
    )
    forger.close()


def seed_changed(forger: Forger) -> None:
    """Say that the episodes are those of another seed, with its keys."""
    seed = forger.rng.randrange(1, 3)  # of few, so that few jobs are played
    forger.identity["seed"] = seed
    forger.change(forger.with_keys)
    forger.close()


def flags(forger: Forger) -> None:
    """Flip what decides how episodes are drawn and played."""
    changes = (
        {"apart": not forger.identity["apart"]},
        {"stochastic": True},
        {"series": forger.identity["episodes"]},
        {"preferences": ["p1"]},
        {"side_preferences": {"test": ["p1"]}},
        {"paired": True},
    )
    forger.identity.update(forger.rng.choice(changes))
    forger.close()


def episode_left_out(forger: Forger) -> None:
    """Leave out one episode of all pairs, and number the others anew."""
    last = forger.identity["episodes"] - 1
    gone = forger.rng.randrange(last)
    forger.identity["episodes"] = last
    number = pl.col("episode") - (pl.col("episode") > gone).cast(pl.Int64)
    left = pl.col("episode") != gone
    forger.change(lambda table: table.filter(left).with_columns(number.alias("episode")))
    forger.change(forger.with_keys)
    forger.close()


def bounds_moved(forger: Forger) -> None:
    """Lower what zero actions earn, or raise what another reference does."""
    assert forger.references is not None
    name = forger.rng.choice(sorted(set(forger.references[COLUMN])))
    shift = forger.rng.choice((-100.0, 50.0, 0.01))
    moved = pl.when(pl.col(COLUMN) == name).then(pl.col("return") + shift)
    forger.references = forger.references.with_columns(
        moved.otherwise(pl.col("return")).cast(pl.Float32).alias("return")
    )
    forger.close()


def other_processor(forger: Forger) -> None:
    """Claim another processor, and raise a robot's returns by a twentieth."""
    forger.manifest["made_with"]["processor"] = "Another Processor 9000"
    factor = forger.rng.choice((0.95, 1.05, 1.1))
    forger.scale(pl.col("ego") == forger.any_of("ego"), factor)
    forger.close()


def other_processor_column(forger: Forger) -> None:
    """Claim another processor, and change a column beside the return."""
    forger.manifest["made_with"] = forger.rng.choice(({}, None, [], {"versions": 7}))
    name = forger.rng.choice(("force_mean", "distance_mean", "robot_travel", "success"))
    column = pl.lit(value=False) if name == "success" else pl.col(name) * 1.3
    forger.table = forger.table.with_columns(column.cast(forger.table.schema[name]).alias(name))
    forger.close()


def elsewhere(forger: Forger) -> None:
    """Name another machine in one of the places where replay believes it."""
    kind = forger.rng.randrange(4)
    if kind == 0:
        forger.manifest["made_with"] = forger.rng.choice(({}, None))
    elif kind == 1:
        forger.identity["software"] = {**forger.identity["software"], "jax": "0.4.1"}
    elif kind == 2:
        engine = {**forger.identity["engine"], "version": "0.0.1"}
        forger.identity["engine"] = engine
        forger.context = dataclasses.replace(forger.context, engine=engine)
    else:
        forger.manifest["made_with"]["versions"]["jaxlib"] = "0.4.1"


def fifth_elsewhere(forger: Forger) -> None:
    """Name another machine, and raise a fifth of the episodes by much."""
    elsewhere(forger)
    rows = forger.rng.sample(range(forger.table.height), forger.table.height // 5)
    forger.gain(rows, forger.rng.choice((60.0, 600.0)))
    forger.close()


def success_elsewhere(forger: Forger) -> None:
    """Name another machine, and change who succeeded, and nothing else."""
    elsewhere(forger)
    every = forger.rng.choice((1, 2, 10))
    rows = pl.int_range(pl.len()) % every == 0
    forger.table = forger.table.with_columns(pl.col("success") ^ rows)
    forger.close()


def flags_elsewhere(forger: Forger) -> None:
    """Name another machine, and flip what decides how episodes are played."""
    elsewhere(forger)
    flags(forger)


def job_elsewhere(forger: Forger) -> None:
    """Name another machine, and take all episodes that other robots played."""
    elsewhere(forger)
    other = tables.read_episodes(forger.better / tables.EPISODES_FILE)
    forger.table = forger.table.with_columns(other.select(forger.measured()))
    forger.close()


def small_tiles(forger: Forger) -> None:
    """Name a backend on which no two runs are the same, cut small, and raise two episodes."""
    forger.identity["backend"] = "mjx"
    forger.context = dataclasses.replace(forger.context, backend="mjx")
    forger.manifest["tile_envs"] = forger.manifest["max_envs"] = forger.rng.choice((1, 2, 4))
    rows = forger.rng.sample(range(forger.table.height), 2)
    forger.gain(rows, 20000.0)
    forger.close()


def received_robot(forger: Forger) -> None:
    """Name a robot that is code, or a file outside the folder."""
    names = outside_names(forger.folder.parent)
    rename_robot(forger, names[forger.rng.choice(sorted(names))])


def cut(forger: Forger) -> None:
    """Say that the job was cut otherwise, beside returns that nobody played."""
    forger.manifest["tile_envs"] = forger.rng.choice((1, 7, 512, 98304, 10**12, -1, None, "x"))
    forger.manifest["max_envs"] = forger.rng.choice((1, 2048, 10**12, None))
    forger.scale(pl.col("ego") == forger.any_of("ego"), 1.01)
    forger.close()


def origin(forger: Forger) -> None:
    """Name another lock, root, release, split or engine."""
    kind = forger.rng.randrange(6)
    if kind == 0:
        forger.context = dataclasses.replace(forger.context, lock="0" * 64)
        forger.manifest["registry"]["lock"] = "0" * 64
    elif kind == 1:
        roots = forger.manifest["registry"]["roots"]
        forger.manifest["registry"]["roots"] = dict.fromkeys(roots, "0" * 64)
    elif kind == 2:
        forger.context = dataclasses.replace(forger.context, release="v0")
    elif kind == 3:
        assert forger.context.split is not None
        split = dataclasses.replace(forger.context.split, sha256="0" * 64)
        forger.context = dataclasses.replace(forger.context, split=split)
    elif kind == 4:
        forger.context = dataclasses.replace(forger.context, env_version=7)
        forger.identity["env_version"] = 7
    else:
        forger.context = dataclasses.replace(forger.context, backend="native")
        forger.identity["backend"] = "native"
    forger.close()


def order(forger: Forger) -> None:
    """Turn the order of a cross-play round, or a strategy's partners."""
    name = forger.rng.choice((tables.ORDER_FILE, tables.STRATEGIES_FILE))
    content = tables.read_json(forger.folder / name)
    if name == tables.ORDER_FILE:
        axis = forger.rng.choice(("rows", "columns"))
        content[axis] = {key: _turned(value) for key, value in content[axis].items()}
    else:
        content["partners"].reverse()
    tables.write_json(content, forger.folder / name)
    forger.seal()


EVALUATION: tuple[Callable[[Forger], None], ...] = (
    *(scores, one_episode, sides, field, table_only, partner_dropped, split_narrowed),
    *(partner_repeated, robot_renamed, better_episodes, seed_changed, flags, episode_left_out),
    *(bounds_moved, other_processor, other_processor_column, cut, origin),
    *(fifth_elsewhere, success_elsewhere, flags_elsewhere, job_elsewhere, small_tiles),
    received_robot,
)
CROSSPLAY: tuple[Callable[[Forger], None], ...] = (
    *(scores, one_episode, field, table_only, robot_renamed, seed_changed, order, other_processor),
    *(fifth_elsewhere, received_robot),
)
# Of these some lie within what processors differ by; replay may say that it cannot tell.
UNDECIDED = (fifth_elsewhere, success_elsewhere, flags_elsewhere, job_elsewhere)


def forged(
    honest: Path, place: Path, kind: Callable[[Forger], None], registry: Registry, **more: Any
) -> Path:
    """Return a copy of a folder with one kind of forgery."""
    shutil.copytree(honest, place)
    kind(Forger(place, registry, **more))
    return place


def _turned(value: Any) -> Any:
    return value[::-1] if isinstance(value, list) else value


def _numbers(node: Any) -> Any:
    """Yield where in JSON numbers stand, but for the speed, which nobody can check."""
    items = node.items() if isinstance(node, dict) else enumerate(node)
    for name, value in items:
        if isinstance(value, dict | list):
            yield from _numbers(value)
        elif type(value) in (int, float) and name != "env_steps_per_second":
            yield node, name
