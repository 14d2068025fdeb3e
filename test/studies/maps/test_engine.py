"""The engine with the real thing: a scheduler and workers as processes, some of them killed."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hostile import answered, settings

from kr270_milling.base.errors import InputError, ModelError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.studies.maps.engine import AHEAD, Study, run_chunks
from kr270_milling.studies.maps.sweep import Sweep, parse_axis

parquet = pytest.importorskip("pyarrow.parquet")
dask = pytest.importorskip("dask")
distributed = pytest.importorskip("dask.distributed")
PATIENCE = 150.0
SHORT = ("path.length_mm=2", "stock.grid_step_um=50", "stock.max_mm=[2,12,0]")


@pytest.fixture(scope="module")
def cluster():
    """The address of a scheduler with two workers."""
    timeouts = {"distributed.comm.timeouts.connect": "3s"}  # of requests for the result of a killed worker
    with dask.config.set(timeouts), distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=":0") as made:
        yield made.scheduler_address


def rows_of(seconds: float = 0.0):
    """Rows of chunks, after some time; workers receive the inner function with its code, and need no file."""

    def rows(number: int) -> bytes:
        time.sleep(seconds)
        return f"rows of chunk {number}".encode()

    return rows


def chunks(study: Study, count: int) -> list[bytes]:
    return [study.chunk(number).read_bytes() for number in range(count)]


def test_a_folder_is_of_one_study(tmp_path):
    Study(tmp_path, {"seed": 1})
    with pytest.raises(InputError, match="another study"):
        Study(tmp_path, {"seed": 2})


def test_no_more_chunks_are_under_way_than_a_few_a_worker(cluster, tmp_path, monkeypatch):
    """A chunk that is submitted and not yet written takes memory of the driver and of the workers."""
    written, under_way, submit = [0], [], distributed.Client.submit

    def counted(*args, **more):
        under_way.append(len(under_way) + 1 - written[-1])
        return submit(*args, **more)

    monkeypatch.setattr(distributed.Client, "submit", counted)
    run_chunks(Study(tmp_path, {}), 100, rows_of(), cluster, lambda done, total: written.append(done))
    assert len(under_way) == 100 and max(under_way) <= 2 * AHEAD


def test_a_killed_worker_loses_no_row(cluster, tmp_path):
    study, count = Study(tmp_path / "study", {}), 12
    with distributed.Client(cluster) as client:
        victim, _ = client.run(os.getpid).values()

    def kill(done, total):
        if done == 2:
            os.kill(victim, signal.SIGKILL)

    run_chunks(study, count, rows_of(0.05), cluster, kill)
    assert chunks(study, count) == [f"rows of chunk {n}".encode() for n in range(count)]


#: a driver that makes nothing itself and stays where it is after four chunks
DRIVER = """
import sys, time
from kr270_milling import cli
from kr270_milling.studies.maps import engine

def write(path, data, whole=engine._write_whole):
    whole(path, data)
    if len(list(path.parent.glob("rows-*"))) == 4:
        time.sleep(1000)

if __name__ == "__main__":
    engine._alone, engine._write_whole = lambda *_: 0, write
    cli.main(sys.argv[1:])
"""


def ctrl_c_is_kept_from(pid: int) -> bool:
    """Whether a process blocks or ignores SIGINT: else each worker prints a traceback."""
    status = Path(f"/proc/{pid}/status").read_text()
    masks = (int(re.search(rf"{name}:\t(\w+)", status)[1], 16) for name in ("SigBlk", "SigIgn"))
    return any(mask >> (signal.SIGINT - 1) & 1 for mask in masks)


def test_a_killed_driver_loses_unwritten_chunks_and_the_same_command_continues(cluster, tmp_path):
    """Workers open no port, and end with it. Rows of processes, of Dask and of a loop are the same bits."""
    psutil = pytest.importorskip("psutil")
    out, script = tmp_path / "out", tmp_path / "driver.py"
    script.write_text(DRIVER)
    words = ["sweep", "paper.yaml", "--vary", "path.depth_of_cut_mm=0.1:1:0.1", "--out", str(out), *settings(*SHORT)]
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    driver = subprocess.Popen([sys.executable, str(script), *words], **silent)
    end = time.monotonic() + PATIENCE
    while len(list(out.glob("rows-*.parquet"))) < 4:
        assert time.monotonic() < end, "no rows"
        time.sleep(0.02)
    processes = [psutil.Process(driver.pid), *psutil.Process(driver.pid).children(recursive=True)]
    ports = [port for process in processes for port in process.net_connections() if port.status == psutil.CONN_LISTEN]
    assert all(ctrl_c_is_kept_from(process.pid) for process in processes[1:])
    driver.kill()
    driver.wait()
    assert len(processes) > 2 and not ports
    before = {path: path.stat().st_mtime_ns for path in out.glob("rows-*.parquet")}
    answer = answered(*words, "--scheduler", cluster)
    assert answer["rows"] == 10 and parquet.read_table(out).num_rows == 10
    assert [row["path.depth_of_cut_mm"] for row in answer["best"]] == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5])
    assert {path: path.stat().st_mtime_ns for path in before} == before  # none was made again
    plain = Sweep(str(find_file("paper.yaml").resolve()), SHORT, (parse_axis("path.depth_of_cut_mm=0.1:1:0.1"),))
    assert chunks(Study(out, json.loads((out / "_study.json").read_text())), 10) == [plain(n) for n in range(10)]
    assert not psutil.wait_procs(processes[1:], timeout=PATIENCE)[1]


def test_a_scheduler_that_is_not_there_is_refused_in_one_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr("kr270_milling.studies.maps.engine.ANSWER", 0.3)
    with pytest.raises(ModelError, match="does not answer"):
        run_chunks(Study(tmp_path, {}), 1, rows_of(), "tcp://127.0.0.1:9")
