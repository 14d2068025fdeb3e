"""Many rows in chunks on Dask: each chunk is a Parquet file of its own, so that a study goes on where it stopped.

Without a scheduler's address a local cluster of as many processes as cores is started, on the loopback interface only.
A chunk depends on nothing but its number, so the rows are the same bit for bit whatever the number of workers.
"""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from kr270_milling.base.errors import InputError, MillingError

__all__ = ["EngineError", "Study", "read_rows", "run_chunks"]

AHEAD = 3  #: chunks a worker that are under way at once: none idles, and memory stays bounded
PLAN = "study.json"


class EngineError(MillingError):
    """The extra libraries are missing, or the scheduler does not answer."""


class Study:
    """A folder of chunks. Raises InputError where it holds those of another study."""

    def __init__(self, folder, plan: dict):
        self.folder, self.plan = Path(folder), json.loads(json.dumps(plan))
        self.folder.mkdir(parents=True, exist_ok=True)
        place = self.folder / PLAN
        if place.exists():
            with contextlib.suppress(ValueError):
                if json.loads(place.read_text(encoding="utf-8")) == self.plan:
                    return
            raise InputError(self.folder, "holds the rows of another study: choose another --out")
        _write_whole(place, json.dumps(self.plan, indent=1).encode())

    def chunk(self, number: int) -> Path:
        """Where the rows of a chunk are, or will be."""
        return self.folder / f"rows-{number:06d}.parquet"

    def missing(self, count: int) -> list[int]:
        """Numbers of the chunks that are not there yet."""
        return [number for number in range(count) if not self.chunk(number).exists()]


def _write_whole(path: Path, data: bytes) -> None:
    draft = path.with_suffix(".part")
    draft.write_bytes(data)
    draft.replace(path)


def run_chunks(
    study: Study,
    count: int,
    rows_of: Callable[[int], bytes],
    scheduler: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> float:
    """Make the missing ones of ``count`` chunks; rows_of(number): the bytes of a Parquet file. Returns seconds.

    A killed worker's chunk is made again by another one; a killed driver loses the chunks under way. Raises
    EngineError where Dask is missing or the scheduler cannot be reached.
    """
    missing, start = study.missing(count), time.monotonic()
    if not missing:
        return 0.0
    with _client(scheduler) as client:
        from dask.distributed import as_completed

        workers = max(1, sum(client.nthreads().values()))
        waiting = iter(missing)
        numbers = {}

        def submit() -> list:
            number = next(waiting, None)
            if number is None:
                return []
            future = client.submit(rows_of, number, key=f"{study.folder.name}-{number}-{os.getpid()}", pure=False)
            numbers[future.key] = number
            return [future]

        first = [future for _ in range(AHEAD * workers) for future in submit()]
        running = as_completed(first)
        done = count - len(missing)
        for future in running:
            _write_whole(study.chunk(numbers.pop(future.key)), future.result())
            future.release()
            done += 1
            if progress is not None:
                progress(done, count)
            for new in submit():
                running.add(new)
    return time.monotonic() - start


@contextlib.contextmanager
def _client(scheduler: str | None) -> Iterator:
    try:
        import dask
        from dask.distributed import Client, LocalCluster
    except ImportError:
        raise EngineError("studies need Dask and Arrow: pip install 'kr270_milling[studies]'") from None
    quiet = {"distributed.logging.distributed": "error", "distributed.admin.log-format": ""}
    with dask.config.set({**quiet, "distributed.scheduler.allowed-failures": 3}):
        if scheduler:
            try:
                client = Client(scheduler, timeout="10s")
            except (OSError, ValueError) as error:
                raise EngineError(f"the scheduler {scheduler} does not answer: {error}") from None
            with client:
                yield client
            return
        cluster = LocalCluster(
            n_workers=os.cpu_count() or 1, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0",
            host="127.0.0.1", silence_logs="ERROR",
        )  # fmt: skip
        with cluster, Client(cluster) as client:
            yield client


def read_rows(folder):
    """All rows of a study as one Arrow table, in the order of their numbers."""
    import pyarrow
    import pyarrow.parquet as parquet

    return pyarrow.concat_tables([parquet.read_table(path) for path in sorted(Path(folder).glob("rows-*.parquet"))])
