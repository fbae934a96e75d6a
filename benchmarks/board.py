"""Commands that measure a board: its pages while many read, and all of it while robots come in."""

import dataclasses
from collections.abc import Sequence
from typing import Any

from assistax_zoo.shell.console import print_json
from benchmarks.timing import check_seconds


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
        readers: How many read at once; each opens a page every five seconds or so.
        seconds: How long they read.
        json: Print JSON.

    Example:
        python -m benchmarks pages --url http://127.0.0.1:8800 --readers 200
    """
    from benchmarks.pages import read_pages

    check_seconds(seconds)
    rows = [dataclasses.asdict(row) for row in read_pages(url, readers, seconds)]
    if json:
        print_json(rows)
        return
    print(f"{readers} readers for {seconds:g} s; milliseconds until the whole page was there")
    _print_pages(rows)


def service(
    *, readers: int = 200, submitters: int = 50, seconds: float = 60.0, json: bool = False
) -> None:
    """Measure a new server while many read its pages, and others hand robots in and watch them.

    A worker brings made-up returns at once: the server is measured, not the physics.

    Args:
        readers: How many read at once; each opens a page every five seconds or so.
        submitters: How many hand in, watch to the end, and begin anew.
        seconds: How long.
        json: Print JSON.

    Example:
        python -m benchmarks service
    """
    from benchmarks.service import measure_service

    check_seconds(seconds)
    row = dataclasses.asdict(measure_service(readers, submitters, seconds))
    if json:
        print_json(row)
        return
    load = " to ".join(f"{value:.1f}" for value in row["load"])
    print(f"{readers} readers and {submitters} submitters for {seconds:g} s; load {load}")
    _print_pages(row["pages"])
    print(
        f"{row['submitted']} submissions, {row['lost']} lost, scored after "
        f"{row['seconds_to_score']:.1f} s; {row['requests']} requests, the server worked "
        f"{row['server_cpu_ms']:.1f} ms for each"
    )


def _print_pages(rows: Sequence[dict[str, Any]]) -> None:
    for row in rows:
        print(
            f"{row['page']:22} {row['reads']:6} reads  median {row['median_ms']:7.1f}  "
            f"p95 {row['p95_ms']:7.1f}  {row['failed']} failed"
        )
