"""Checkpoints of training state, through Orbax.

A checkpoint is written wholly or not at all, and restores the same bits on any devices.
"""

import hashlib
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp

from assistax_base.errors import lacks_memory

KEEP = 2  # newest checkpoints that stay on disk: the last, and a spare in case of damage
_DIGEST, _RUN = "sha256", "run"


class OtherRunError(ValueError):
    """Error for an intact checkpoint that belongs to another run."""


class Checkpoints:
    """Checkpoints of a run, by number of updates done.

    Args:
        folder: Folder of the checkpoints.
        key: Digest of the run; checkpoints with another digest are refused.
    """

    def __init__(self, folder: Path, key: str | None = None) -> None:
        self.folder = folder.resolve()
        try:
            str(self.folder).encode()
        except UnicodeEncodeError:
            raise ValueError(
                f"{folder} has a name that is not UTF-8, under which no checkpoint can be written; "
                "choose another folder"
            ) from None
        self._key = np.frombuffer(bytes.fromhex(key or "00" * 32), np.uint8)
        options = ocp.CheckpointManagerOptions(
            max_to_keep=KEEP, enable_async_checkpointing=False, cleanup_tmp_directories=True
        )
        self._manager = ocp.CheckpointManager(self.folder, options=options)

    def latest(self) -> int | None:
        """Return the number of updates of the newest complete checkpoint, or None."""
        return self._manager.latest_step()

    def save(self, update: int, state: Any) -> None:
        """Write a checkpoint; delete all but the newest `KEEP`.

        Raises:
            OSError: It cannot be written. Existing checkpoints are untouched.
        """
        last, arrays = self.latest(), {**_to_arrays(state), _RUN: self._key}
        arrays[_DIGEST] = _digest(arrays)
        try:
            self._manager.save(update, args=ocp.args.StandardSave(arrays))
        except Exception as error:
            if lacks_memory(error):
                raise
            reason = str(error).strip().partition("\n")[0]
            kept = (
                f"the last good one is of update {last}"
                if last is not None
                else "there is no earlier one"
            )
            raise OSError(
                f"cannot write the checkpoint of update {update} to {self.folder}: {reason}; "
                f"{kept}; free some space there and run the same command again to continue"
            ) from error

    def restore_latest(self, like: Any) -> tuple[int, Any] | None:
        """Return the newest intact checkpoint as (updates, state); None if there is none.

        A damaged one is removed with a warning, and the one before it is used: the run repeats the
        updates between them. If memory is too small to read it, nothing is removed.

        Args:
            like: A state of the same structure, on the devices that the result is to lie on.

        Raises:
            OtherRunError: A checkpoint is of another run.
            ValueError: There are checkpoints, and all are unreadable.
        """
        updates, reason = sorted(self._manager.all_steps(), reverse=True), ""
        for update in updates:
            try:
                state = self._restore(update, like)
            except OtherRunError:
                raise
            except Exception as error:
                if lacks_memory(error):
                    raise
                reason = reason or str(error).strip().partition("\n")[0]
                continue
            for damaged in (newer for newer in updates if newer > update):
                warnings.warn(
                    f"the checkpoint of update {damaged} in {self.folder} is damaged ({reason}); "
                    f"going on from the one of update {update}",
                    stacklevel=2,
                )
                self._manager.delete(damaged)
            return update, state
        if updates:
            raise ValueError(
                f"cannot read the checkpoint of update {updates[0]} in {self.folder}: {reason}; "
                "it was written by another version or is damaged: start a new run in another folder"
            )
        return None

    def _restore(self, update: int, like: Any) -> Any:
        """Return the state of one checkpoint, after a check of its digest and its run."""
        like_arrays = {**_to_arrays(like), _RUN: self._key}
        like_arrays[_DIGEST] = _digest({})
        saved: Any = self._manager.restore(update, args=ocp.args.StandardRestore(like_arrays))
        digest = saved.pop(_DIGEST, None)
        if digest is None or not np.array_equal(digest, _digest(saved)):
            raise ValueError("its bytes are not those that were written")
        if not np.array_equal(saved.pop(_RUN), self._key):
            raise OtherRunError(
                f"the checkpoint of update {update} in {self.folder} is of another run than the "
                "folder's configuration; take it away, or start a new run in another folder"
            )
        return _from_arrays(saved, like)

    def close(self) -> None:
        """Release the folder."""
        self._manager.close()


def _digest(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the sha256 of all leaves [32], since Orbax loads flipped bits without an error."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        leaf = np.ascontiguousarray(arrays[name])
        digest.update(f"{name}:{leaf.dtype}:{leaf.shape};".encode())
        digest.update(leaf.reshape(-1).view(np.uint8).data)
    return np.frombuffer(digest.digest(), np.uint8)


def _to_arrays(state: Any) -> dict[str, np.ndarray]:
    """Return the leaves by path, as arrays.

    Typed keys become their data, and empty leaves, which Orbax refuses, are left out.
    """
    return {
        _name(path): np.asarray(jax.random.key_data(leaf) if _is_key(leaf) else leaf)
        for path, leaf in jax.tree_util.tree_leaves_with_path(state)
        if leaf.size
    }


def _from_arrays(arrays: Mapping[str, np.ndarray], like: Any) -> Any:
    """Return a state like `like` with the values of arrays by path: the inverse of `_to_arrays`."""

    def leaf(path: Any, like: jax.Array) -> jax.Array:
        if not like.size:
            return like
        value = jax.device_put(arrays[_name(path)], like.sharding)
        return (
            jax.random.wrap_key_data(value, impl=jax.random.key_impl(like))
            if _is_key(like)
            else value
        )

    return jax.tree_util.tree_map_with_path(leaf, like)


def _name(path: Any) -> str:
    return jax.tree_util.keystr(path, simple=True, separator=".")


def _is_key(leaf: jax.Array) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
