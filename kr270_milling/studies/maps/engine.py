"""Many rows in chunks on Dask: each chunk is a separate Parquet file, so that a study continues after a stop.

Without a scheduler's address a local cluster of as many processes as cores is started, on the loopback interface only,
unless the work is done before it would be up.
A chunk depends on nothing but its number, so the rows are the same bit for bit whatever the number of workers.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import itertools
import json
import math
import multiprocessing
import os
import signal
import time
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from pathlib import Path

from kr270_milling.base.errors import InputError, MillingError
from kr270_milling.base.record import read_tree
from kr270_milling.cell.cell import Cell

__all__ = ["EngineError", "StudyRows", "Study", "content", "run_chunks"]

AHEAD = 3  #: chunks a worker that are under way at once: none idles, and memory stays bounded
ALONE = 4.0  #: [s] of work that is done before a local cluster is up
SEVERAL = 16  #: chunks, above which a local cluster is prepared while the first is made
ANSWER = 10.0  #: [s] for a scheduler to answer
PATIENCE = 30.0  #: [s] for a first worker
LOOK = 1.0  #: [s] between two looks at the number of workers
PLAN = "_study.json"  # Arrow leaves out names that begin with "_" where it reads the folder
METHOD = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
QUIET = {
    "distributed.logging.distributed": "critical",  # a worker that ends may miss a heartbeat
    "distributed.admin.log-format": "",
    "distributed.scheduler.allowed-failures": 3,
    "distributed.admin.low-level-log-length": 10,  # each of its entries holds a task with the cell: 1000 grew by 90 MB
}
#: of a local cluster: what its processes watch beside their work took a tenth of a core
LOCAL = {
    "distributed.worker.multiprocessing-method": METHOD,
    "distributed.worker.profile.enabled": False,
    "distributed.worker.memory.monitor-interval": "1s",
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
    # else a worker gives the memory of each array back at once, and gets every page of the next one anew
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
}


class EngineError(MillingError):
    """The scheduler does not answer, or has no worker."""


class StudyRows:
    """The rows of a study; a worker makes any chunk of them from its number alone."""

    chunk: int  #: rows a file

    def __len__(self) -> int:
        raise NotImplementedError

    def columns(self, first: int, last: int) -> dict:
        """The columns of the rows of the numbers first to last."""
        raise NotImplementedError

    @property
    def chunks(self) -> int:
        """Number of files."""
        return -(-len(self) // self.chunk)

    def __call__(self, number: int) -> bytes:
        """The Parquet bytes of one chunk."""
        import pyarrow as pa
        from pyarrow import parquet

        first = number * self.chunk
        sink = io.BytesIO()
        table = pa.table(self.columns(first, min(first + self.chunk, len(self))))
        parquet.write_table(table, sink, compression="zstd")
        return sink.getvalue()


class Study:
    """A folder of chunks. Raises InputError where it holds those of another study."""

    def __init__(self, folder, plan: dict):
        self.folder, self.plan = Path(folder), json.loads(json.dumps(plan))
        self.folder.mkdir(parents=True, exist_ok=True)
        place, before = self.folder / PLAN, self.folder / PLAN[1:]
        if before.exists():  # of version 0.2
            before.replace(place)
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
        """Return the numbers of the missing chunks."""
        return [number for number in range(count) if not self.chunk(number).exists()]

    def tables(self, count: int, columns=None) -> Iterator:
        """The chunks as Arrow tables, one after the other, so that memory holds one."""
        from pyarrow import parquet

        for number in range(count):
            yield parquet.read_table(self.chunk(number), columns=columns)


def content(path, cell: Cell) -> str:
    """Return a hash of a parameter file and its tool path: rows of another cell have another hash."""
    tree = json.dumps(read_tree(path), sort_keys=True, default=str)
    return hashlib.sha256(f"{tree}{cell.programmed.sha256}".encode()).hexdigest()


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
    EngineError where the scheduler cannot be reached, has no worker or goes away.
    """
    missing, start = study.missing(count), time.monotonic()
    first = count - len(missing)
    if scheduler is None:
        if len(missing) > SEVERAL:
            _prepare(rows_of)
        missing = missing[_alone(study, missing, rows_of, lambda made: progress and progress(first + made, count)) :]
    if not missing:
        return time.monotonic() - start
    done = count - len(missing)
    if scheduler is None:
        _prepare(rows_of)
    with _client(scheduler) as client:
        try:
            for number, data in _made(client, f"{study.folder.name}-{uuid.uuid4().hex}", missing, rows_of):
                _write_whole(study.chunk(number), data)
                done += 1
                if progress is not None:
                    progress(done, count)
        except (CancelledError, OSError, TimeoutError) as error:
            text = f"the workers have stopped, or lack this package ({error}); the same command continues the study"
            raise EngineError(text) from None
    return time.monotonic() - start


def _prepare(rows_of: Callable[[int], bytes]) -> None:
    """Start the process that local workers are forked from: it imports what they need while first chunks are made.

    A worker inherits that SIGINT is blocked: Ctrl-C reaches this process alone, which ends the workers.
    """
    if METHOD == "forkserver":
        from multiprocessing import forkserver, get_context, resource_tracker

        os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))
        modules = ["distributed", "pandas", "pyarrow.parquet", type(rows_of).__module__]
        get_context(METHOD).set_forkserver_preload(modules)
        resource_tracker.ensure_running()  # its start unblocks SIGINT
        before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            forkserver.ensure_running()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _alone(study: Study, missing: list[int], rows_of: Callable[[int], bytes], made: Callable[[int], object]) -> int:
    """Make chunks here as long as the rest takes less than the start of a cluster; returns how many were made."""
    for k, number in enumerate(missing):
        start = time.monotonic()
        _write_whole(study.chunk(number), rows_of(number))
        made(k + 1)
        took = time.monotonic() - start
        # the first chunk may compile, so that a short one has a second try
        if took * (len(missing) - k - 1) > ALONE and (k > 0 or took > ALONE / 4):
            return k + 1
    return len(missing)


def _made(client, name: str, missing: list[int], rows_of: Callable[[int], bytes]) -> Iterator[tuple[int, bytes]]:
    """Yield number and bytes of each finished chunk; at most AHEAD chunks for each thread are under way.

    Each chunk carries ``rows_of``. If one worker stored ``rows_of`` for all chunks, Dask would send all chunks there.
    """
    from dask.distributed import as_completed

    client.wait_for_workers(1, timeout=PATIENCE)
    waiting = iter(missing)
    numbers: dict[str, int] = {}
    running = as_completed(with_results=True)  # results come while others are made, not in a separate round trip
    looked = -math.inf
    while True:
        if time.monotonic() - looked > LOOK:  # workers come and go
            most, looked = AHEAD * max(1, sum(client.nthreads().values())), time.monotonic()
        for number in itertools.islice(waiting, max(0, most - len(numbers))):
            future = client.submit(rows_of, number, key=f"{name}-{number}", pure=False)
            numbers[future.key] = number
            running.add(future)
        if not numbers:
            return
        future, data = next(running)
        yield numbers.pop(future.key), data
        future.release()


@contextlib.contextmanager
def _client(scheduler: str | None) -> Iterator:
    import dask
    from dask.distributed import Client, LocalCluster

    with dask.config.set(QUIET if scheduler else QUIET | LOCAL), contextlib.ExitStack() as stack:
        where = scheduler or stack.enter_context(LocalCluster(
            n_workers=os.cpu_count() or 1, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0",
            scheduler_kwargs={"dashboard": False}, host="127.0.0.1", silence_logs="CRITICAL",
        ))  # fmt: skip
        try:
            client = Client(where, timeout=ANSWER if scheduler else PATIENCE)
        except (OSError, ValueError) as error:
            raise EngineError(f"the scheduler {where} does not answer: {error}") from None
        yield stack.enter_context(client)
