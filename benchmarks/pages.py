"""Readers of a running server's pages, and the commands that measure with them."""

import asyncio
import dataclasses
import random
import re
import time
from collections.abc import Sequence
from typing import Any

import httpx2
import numpy as np

from assistax_zoo.shell.console import print_json
from benchmarks.timing import check_seconds

PAUSE = 5.0  # seconds that a reader looks at a page, on average


@dataclasses.dataclass(frozen=True)
class PageSpeed:
    """Reading times of one kind of page."""

    page: str
    reads: int
    median_ms: float
    p95_ms: float
    failed: int


def read_pages(url: str, readers: int, seconds: float) -> list[PageSpeed]:
    """Return the reading times of each kind of page and of all, for readers during some seconds."""
    try:
        reads = asyncio.run(_read_all(url, readers, seconds))
    except httpx2.HTTPError as error:
        reason = str(error) or type(error).__name__
        raise OSError(f"{url} does not answer ({reason}); start a server there first") from None
    kinds = sorted({kind for kind, _, _ in reads})
    rows = [_row(kind, [read for read in reads if read[0] == kind]) for kind in kinds]
    return [*rows, _row("all", reads)]


_Read = tuple[str, float, bool]  # kind of page, seconds, whether it came


async def _read_all(url: str, readers: int, seconds: float) -> list[_Read]:
    limits = httpx2.Limits(max_connections=readers, keepalive_expiry=2.0)  # the server: 5
    async with httpx2.AsyncClient(base_url=url, limits=limits, timeout=30.0) as client:
        pages = await _pages(client)
        for address in pages.values():  # computed pages are cached before the measurement
            await client.get(address, timeout=None)
        end = time.monotonic() + seconds
        readings = [_reader(client, pages, end, random.Random(i)) for i in range(readers)]
        return [read for reading in await asyncio.gather(*readings) for read in reading]


async def _pages(client: httpx2.AsyncClient) -> dict[str, str]:
    """Return one address of each kind of page that the server has."""
    home = (await client.get("/", timeout=None)).text
    tasks = re.findall(r'href="(/tasks/[a-z_]+)"', home)
    board = (await client.get(tasks[0], timeout=None)).text
    kinds = {
        "submission": r'href="(/submissions/\w+)"',
        "compare": r'href="(/tasks/\w+/compare)"',
        "explorer": r'href="(/tasks/\w+/explorer)"',
        "partners": r'href="(/tasks/\w+/partners)"',
        "season": r'href="(/seasons/\w+)"',
    }
    links = {kind: re.search(pattern, board) for kind, pattern in kinds.items()}
    known = {kind: link[1] for kind, link in links.items() if link}
    return {"home": "/", "board": tasks[0], "ledger": "/ledger", **known}


async def _reader(
    client: httpx2.AsyncClient, pages: dict[str, str], end: float, rng: random.Random
) -> list[_Read]:
    """Return one reader's reads; the first waits for part of a pause, so that starts are spread."""
    reads: list[_Read] = []
    await asyncio.sleep(rng.uniform(0, PAUSE))
    while time.monotonic() < end:
        kind, address = rng.choice(list(pages.items()))
        began = time.monotonic()
        try:
            came = (await client.get(address)).status_code == 200
        except httpx2.HTTPError:
            came = False
        reads.append((kind, time.monotonic() - began, came))
        await asyncio.sleep(rng.uniform(0.5, 1.5) * PAUSE)
    return reads


def _row(kind: str, reads: list[_Read]) -> PageSpeed:
    """Return the reading times of one kind of page."""
    times = np.array([seconds for _, seconds, _ in reads]) * 1000
    median, p95 = (float(np.quantile(times, at)) if reads else 0.0 for at in (0.5, 0.95))
    return PageSpeed(kind, len(reads), median, p95, sum(not came for _, _, came in reads))


def pages(
    *,
    url: str = "http://127.0.0.1:8800",
    readers: int = 200,
    seconds: float = 20.0,
    json: bool = False,
) -> None:
    """Measure how long a running server takes for its pages while many read them.

    Args:
        url: Address of the server, which `assistax-zoo serve` prints.
        readers: Number of simultaneous readers; each opens a page about every five seconds.
        seconds: Measuring time.
        json: Print JSON.

    Example:
        python -m benchmarks pages --url http://127.0.0.1:8800 --readers 200
    """
    check_seconds(seconds)
    rows = [dataclasses.asdict(row) for row in read_pages(url, readers, seconds)]
    if json:
        print_json(rows)
        return
    print(f"{readers} readers for {seconds:g} s; milliseconds until the whole page was there")
    _print_pages(rows)


def service(
    *,
    readers: int = 200,
    submitters: int = 50,
    seconds: float = 60.0,
    json: bool = False,
) -> None:
    """Measure a new server while many read its pages, and others submit robots and watch them.

    A worker brings made-up returns at once: the server is measured, not the physics.

    Args:
        readers: Number of simultaneous readers; each opens a page about every five seconds.
        submitters: Number of labs that submit, watch to the end, and begin anew.
        seconds: Measuring time.
        json: Print JSON.

    Example:
        python -m benchmarks service
    """
    from benchmarks.service import measure_service

    check_seconds(seconds)
    row = dataclasses.asdict(measure_service(readers, submitters, seconds))
    if json:
        print_json(row)
    else:
        _print_service(row, readers, submitters, seconds)


def _print_service(row: dict[str, Any], readers: int, submitters: int, seconds: float) -> None:
    load = " to ".join(f"{value:.1f}" for value in row["load"])
    print(f"{readers} readers and {submitters} submitters for {seconds:g} s; load {load}")
    _print_pages(row["pages"])
    print(
        f"{row['submitted']} submissions, {row['lost']} lost, scored after "
        f"{row['seconds_to_score']:.1f} s; {row['requests']} requests, the server worked "
        f"{row['server_cpu_ms']:.1f} ms for each"
    )


def storm(
    *,
    files: int = 100,
    bodies: int = 64,
    readers: int = 200,
    crowd: int = 2000,
    seconds: float = 60.0,
    database: str | None = None,
) -> None:
    """Attack a new server in many ways at once, and print its answers and losses as JSON.

    Args:
        files: Hostile ONNX files.
        bodies: Bodies of requests that come a byte a second.
        readers: Number of simultaneous readers.
        crowd: Connections that stay open and say nothing more.
        seconds: Measuring time.
        database: Address of an empty PostgreSQL database; default SQLite.

    Example:
        python -m benchmarks storm
    """
    from benchmarks.storm import measure_storm

    check_seconds(seconds)
    print_json(dataclasses.asdict(measure_storm(files, bodies, readers, crowd, seconds, database)))


def _print_pages(rows: Sequence[dict[str, Any]]) -> None:
    for row in rows:
        print(
            f"{row['page']:22} {row['reads']:6} reads  median {row['median_ms']:7.1f}  "
            f"p95 {row['p95_ms']:7.1f}  {row['failed']} failed"
        )
