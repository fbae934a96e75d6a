"""The user's splits of official partners: a file in the data folder, beside zoos that were added.

A split's id ends in a digest of its content, so an own split needs no namespace: an official split
of the same id has the same teams. A split of the user's own teams lies in their registry.
"""

from typing import Literal

from pydantic import ValidationError

from assistax_base.bounded_reading import read_text
from assistax_base.errors import RegistryError, SplitError
from assistax_base.validated import first_problem
from zoo.history.official import is_official
from zoo.locations import own_splits_file
from zoo.schema import RegistryFile, Split, StrictModel

MAX_SPLITS_BYTES = 16 * 1024 * 1024


class SplitsFile(StrictModel):
    """Content of the file of own splits."""

    schema_version: Literal[1] = 1
    splits: tuple[Split, ...]


def own_splits(data: RegistryFile) -> tuple[Split, ...]:
    """Return the user's splits of the partners of an official registry that it does not publish.

    Raises:
        RegistryError: The file cannot be read.
        SplitError: The registry publishes another split under the id of an own one.
    """
    if not own_splits_file().is_file() or not is_official(data):
        return ()
    published = {split.id: split for split in data.splits}
    own = [split for split in read_splits() if split.release in data.releases]
    for split in own:
        if published.get(split.id, split) != split:
            raise SplitError(
                f"own split {split.id}",
                "an id that no other split has",
                "an official split of this id with other content",
                f"take it out of {own_splits_file()}",
            )
    return tuple(split for split in own if split.id not in published)


def read_splits() -> tuple[Split, ...]:
    """Return all splits of the file, which must be there."""
    path = own_splits_file()
    remedy = "restore it, or delete it and make your splits again"
    text = read_text(path, MAX_SPLITS_BYTES, RegistryError, "own splits", remedy)
    try:
        return SplitsFile.model_validate_json(text).splits
    except ValidationError as error:
        expected = "a file that `split create` wrote"
        found = first_problem(error)
        raise RegistryError(f"own splits {path}", expected, found, remedy) from None
