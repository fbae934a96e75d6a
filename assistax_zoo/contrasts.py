"""Methods compared as a file says that was written before the test side was played."""

from collections.abc import Sequence
from pathlib import Path

from assistax_zoo.results import evaluation_of, paired_records
from evaluation.cast.met_partners import comparison_notes
from evaluation.figures.contrasts import (
    ContrastFigures,
    Pair,
    contrast_figures,
    named_pairs,
    read_contrasts,
)


def compare_named(
    contrasts: Path | str, folders: Sequence[Path | str], *, seed: int = 0
) -> ContrastFigures:
    """Return what came of the contrasts that a file names, on the test side.

    Each is a method less a baseline with the same partners and episodes: an interval that resamples
    seeds and partners, a p-value, the same corrected for all named contrasts by Holm, and the
    difference that is found in 80% of repetitions. Methods beside a baseline of the file that it
    does not name are shown too, as not named.

    Args:
        contrasts: The file, TOML or JSON, see `evaluation.figures.contrasts`.
        folders: Finished evaluations, one for each method and task; a folder's name is its
            method's.
        seed: Of the resamples.

    Raises:
        FormatError: The file is none of contrasts.
        ValueError: Two folders are of one method and task, or methods were not evaluated alike.
    """
    path = Path(contrasts)
    file, digest = read_contrasts(path)
    results = {}
    for folder in map(Path, folders):
        result = evaluation_of(folder)
        key = result.summary.task, folder.resolve().name
        if key in results:
            raise ValueError(
                f"{folder} and {results[key].folder} are both {key[1]} on {key[0]}; a folder is "
                "named for its method, so give one for each method and task"
            )
        results[key] = result
    pairs, notes = {}, []
    for task, method, baseline in named_pairs(file, list(results)):
        first, second = results[task, method], results[task, baseline]
        records, met = paired_records(first, second)
        split = first.summary.split.id if first.summary.split else None
        pairs[task, method, baseline] = Pair(*records, split)
        notes += comparison_notes(met)
    figures = contrast_figures(file, digest, path.name, pairs, seed=seed)
    said = tuple(dict.fromkeys((*figures.notes, *notes)))
    return ContrastFigures(**vars(figures) | {"notes": said})
