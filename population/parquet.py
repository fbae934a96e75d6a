"""Parquet files that anybody may have damaged: read, or refused in one line."""

from pathlib import Path

import polars as pl


def read_parquet(path: Path) -> pl.DataFrame:
    """Return a table.

    Raises:
        ValueError: The file is damaged, or no Parquet.
    """
    try:
        return pl.read_parquet(path)
    except BaseException as error:
        # Polars' reader can panic on damaged bytes: a BaseException, which no handler expects.
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise ValueError(
            f"{path} is not a readable Parquet file ({reason}); delete it and run again"
        ) from None
