"""Files of an untrusted folder or archive: regular files only, of known names, within bounds."""

import os
import re
import stat
import tarfile
import zlib
from pathlib import Path, PurePosixPath

from zoo.errors import ForeignError, shorten

INDEX_FILE = "index.csv"
MAX_MEMBERS = 250_000
MAX_INDEX_BYTES = 64 * 1024 * 1024
MAX_CONFIG_BYTES = 1024 * 1024
MAX_PARAMS_BYTES = 256 * 1024 * 1024
MAX_TOTAL_BYTES = 8 * 1024 * 1024 * 1024

NAME = r"[0-9A-Za-z][0-9A-Za-z_-]{0,63}"
_KNOWN = {
    re.compile(r"index\.csv"): MAX_INDEX_BYTES,
    re.compile(rf"config/{NAME}\.yaml"): MAX_CONFIG_BYTES,
    re.compile(rf"params/{NAME}\.safetensors"): MAX_PARAMS_BYTES,
}


def extract(archive: Path, folder: Path) -> None:
    """Write the files of a zoo's `.tar.gz` that have a known name to a folder; anything else is left out.

    Raises:
        ForeignError: The archive is damaged, holds a link, a device or a path that leaves it, names
            a file twice, or is larger than the bounds of this module.
    """
    total, seen = 0, set()
    try:
        with tarfile.open(archive, mode="r|gz") as tar:
            for count, member in enumerate(tar):
                total += member.size
                if count >= MAX_MEMBERS or total > MAX_TOTAL_BYTES:
                    bounds = f"at most {MAX_MEMBERS} members and {MAX_TOTAL_BYTES} bytes"
                    raise refusal(f"archive {archive}", bounds, f"more, at {shorten(member.name)}")
                name = _member_name(archive, member)
                if name is None:
                    continue
                if name in seen:
                    raise refusal(f"archive {archive}", "each file once", f"{name} twice")
                seen.add(name)
                content = tar.extractfile(member)
                data = content.read() if content else b""
                (folder / name).parent.mkdir(exist_ok=True)
                (folder / name).write_bytes(data)
    except (tarfile.TarError, zlib.error, EOFError, OSError, ValueError) as error:
        if isinstance(error, OSError) and error.filename:
            raise
        raise refusal(f"archive {archive}", "a readable .tar.gz", shorten(str(error))) from None


def read_member(folder: Path, name: str) -> bytes:
    """Return one file of a zoo's folder, which is neither a link nor larger than its kind may be.

    Raises:
        ForeignError: It is missing, a link, no regular file, or too large.
    """
    limit = next(bound for pattern, bound in _KNOWN.items() if pattern.fullmatch(name))
    path = folder
    for part in PurePosixPath(name).parts:
        path = path / part
        if path.is_symlink():
            raise refusal(str(path), "a file", "a link")
    try:
        # Without O_NONBLOCK a named pipe would wait for ever.
        descriptor = os.open(
            path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
        )
    except FileNotFoundError:
        raise refusal(str(path), "a file", "none") from None
    with os.fdopen(descriptor, "rb") as file:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise refusal(str(path), "a regular file", "something else")
        data = file.read(limit + 1)
    if len(data) > limit:
        raise refusal(str(path), f"at most {limit} bytes", "more")
    return data


def refusal(problem: str, expected: str, found: str) -> ForeignError:
    """Return the error of an import that was refused."""
    return ForeignError(
        problem,
        expected=expected,
        found=found,
        done="nothing was imported",
        next_step="get the zoo again from its publisher; `assistax-zoo import --help` describes what is read",
    )


def _member_name(archive: Path, member: tarfile.TarInfo) -> str | None:
    """Return a member's name within the zoo, None for what is not read; refuse what no zoo holds."""
    path = PurePosixPath(member.name)
    if path.is_absolute() or ".." in path.parts or "\\" in member.name or "\0" in member.name:
        raise refusal(f"archive {archive}", "paths within the archive", shorten(member.name))
    if member.isdir():
        return None
    if not member.isreg():
        raise refusal(
            f"archive {archive}",
            "regular files and folders",
            f"{shorten(member.name)}, a link or device",
        )
    # The zoo's own folder may stand in front of its files.
    for name in ("/".join(path.parts), "/".join(path.parts[1:])):
        for pattern, bound in _KNOWN.items():
            if pattern.fullmatch(name):
                if member.size > bound:
                    raise refusal(
                        f"archive {archive}", f"at most {bound} bytes", f"{name} of {member.size}"
                    )
                return name
    return None
