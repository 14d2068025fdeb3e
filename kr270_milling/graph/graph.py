"""The four nodes as processes: started, driven through the lifecycle, watched, and always stopped again."""

from __future__ import annotations

import contextlib
import functools
import os
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kr270_milling.base.process import exit_code
from kr270_milling.cell.cell import Cell
from kr270_milling.graph.driver import Driver
from kr270_milling.graph.processes import Child, RunError, recording_parameters, ros_arguments, stop, write_cell
from kr270_milling.graph.watchdog import COMPENSATOR, CUT, RECORDER, ROBOT, Hooks, Watchdog, claim, unmatched
from kr270_milling.ros.environment import keep_to_this_host
from kr270_milling.ros.litter import remove_litter

__all__ = ["CELL", "NOT_COMPLETE", "PLANNER", "Graph", "PassRun"]

UP = 60.0  # [s] for a node to come up, to compile at its first use, or to revise a long trajectory
MATCH = 30.0  # [s] for the nodes to find each other
FRESH = 1.0  # [s] since the last report of a node that reports
CATCH_UP = 5.0  # [s] that a recorder has at the end of a pass to ask for what it was too slow for
METHOD = "compensation.method"
CELL, PLANNER = (ROBOT, CUT), (COMPENSATOR, RECORDER)  # the two processes of a composed graph
NOT_COMPLETE = "its recording is not complete"


@dataclass(frozen=True)
class PassRun:
    """What the graph itself tells of one pass; the rest is in the recording."""

    name: str
    recording: Path
    reference: str  #: fingerprint of the reference trajectory
    wall_s: float  #: from the first exchange to the last [s]
    errors: tuple[float, ...]  #: remaining error of every pass of this method so far [m], as the compensator sees it
    finished: bool  #: the compensator will not improve any more


class Graph:
    """Context manager: on entry the nodes come up, on exit they are gone, whatever happened in between.

    out: an existing directory that gets cell.yaml, logs and recordings; composed: robot and cut in one process,
    compensator and recorder in another; plant: what robot and cut are in the place of the cell, by which the
    compensator plans. Raises RunError, AlreadyRunning.
    """

    def __init__(
        self,
        cell: Cell,
        out: Path,
        namespace: str = "",
        extra: tuple[str, ...] = (),
        stagger: float = 0.0,
        composed: bool = False,
        hooks: Hooks | None = None,
        plant: Cell | None = None,
    ):
        self.cell = cell
        self.plant = plant
        self.out = Path(out).resolve()
        self.extra = extra
        self._driver: Driver | None = None
        self._claimed = contextlib.ExitStack()  # the names of its nodes
        self.children: dict[str, Child] = {}
        self.passes = 0  #: that were recorded
        self.spawned: dict[str, tuple] = {}  #: name of a process -> its nodes, parameter file and further arguments
        self._stagger = stagger
        self._composed = composed
        self._namespace = namespace
        self._hooks = hooks or Hooks()
        self._watchdog = Watchdog({ROBOT, CUT, COMPENSATOR, RECORDER}, self._hooks.tell)
        self._signals: list[int] = []
        self._handlers: dict[int, Any] = {}

    def __enter__(self) -> Graph:
        started = time.monotonic()
        keep_to_this_host()
        remove_litter()
        (self.out / "log").mkdir(exist_ok=True)
        write_cell(self.cell, self.out / "cell.yaml")
        if self.plant is not None:
            write_cell(self.plant, self.out / "plant.yaml")
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._handlers[number] = signal.signal(number, lambda caught, _: self._signals.append(caught))
        try:
            self._driver = Driver(self._namespace, self.check)
            self._claimed.enter_context(claim(self.driver.domain, self.driver.namespace))
            self._start(started)
        except BaseException as error:
            self.close(error)
            raise
        return self

    @property
    def driver(self) -> Driver:
        """The runner's own node, as long as the graph is up."""
        if self._driver is None:
            raise RunError("graph", "is not up")
        return self._driver

    def _start(self, started: float) -> None:
        cuts = self.out / ("cell.yaml" if self.plant is None else "plant.yaml")
        tracked = () if self.plant is None else ("-p", f"plant:={cuts}")
        own = f"{RECORDER}_{os.getpid()}"  # the recorder of another graph must not hear where this one records
        self.driver.addresses[RECORDER] = own
        alone = ("-r", f"{RECORDER}/set_parameters:={own}/set_parameters")
        records = ("-p", "autostart:=false", *alone, *self._recorded_topics())
        for nodes in (CELL, PLANNER) if self._composed else ((node,) for node in (*CELL, *PLANNER)):
            parameters = cuts if nodes[0] in CELL else self.out / "cell.yaml"
            more = [*(tracked if COMPENSATOR in nodes else ()), *(records if RECORDER in nodes else ())]
            self.spawn(nodes, parameters, *more, *self.extra)
            self._pause(self._stagger)
        self.driver.until(lambda: all(map(self.driver.status, (*CELL, *PLANNER))), "coming up", UP)
        self.driver.transitions([(ROBOT, "configure"), (CUT, "configure")], UP)
        self._watchdog.excused = set()
        self._watchdog.coming_up = False
        self._wait_matched(recorded=False)
        self._share_out_cores()
        self.up_s = time.monotonic() - started

    def _share_out_cores(self) -> None:
        """Robot and cut work by turns, so one core is enough for both; to wake the other on another core took as long
        again as the whole exchange. Compensator and recorder have the rest."""
        cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
        if len(cores) < 2:
            return
        own = sorted(cores)[os.getpid() % len(cores)]
        for node, child in self.children.items():
            child.keep_to({own} if node in CELL else cores - {own})

    @contextlib.contextmanager
    def interruptible(self) -> Iterator[None]:
        """Within, where nobody waits for the graph, a signal ends this process as it does without one."""
        self.check()
        ours = {number: signal.signal(number, handler) for number, handler in self._handlers.items()}
        try:
            yield
        finally:
            for number, handler in ours.items():
                signal.signal(number, handler)

    def _pause(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.check()
            self.driver.spin()

    def _recorded_topics(self) -> tuple[str, ...]:
        """In a namespace nothing else is recorded but the reports of all nodes."""
        space = self.driver.namespace
        return () if space == "/" else ("-p", f"topics:=[{space}/*,/diagnostics]")

    def spawn(self, nodes: tuple[str, ...], parameters: Path, *arguments: str) -> None:
        """Start a process that holds one node or several; arguments as behind ``--ros-args``."""
        child = Child(nodes, ros_arguments(parameters, self.driver.namespace, *arguments), self.out / "log")
        self.spawned[child.name] = nodes, parameters, arguments
        for node in nodes:
            self.children[node] = child
            self.driver.expect(node, child.pid)

    def check(self) -> None:
        """Called all the time while something is waited for; raises when the graph cannot go on."""
        if self._signals:
            if self._signals[0] == signal.SIGTERM:
                raise SystemExit(128 + signal.SIGTERM)
            raise KeyboardInterrupt
        if self._driver is not None:
            self._hooks.looked()
            self._watchdog.look(self.driver, self.children)

    @contextlib.contextmanager
    def _excuse(self, node: str):
        """A node that is busy with something long is not expected to report, nor is who shares its process."""
        names = {name for name, child in self.children.items() if child is self.children[node]}
        self._watchdog.excused |= names
        yield
        self.driver.spin()
        for name in names:
            self.driver.until(functools.partial(self._is_fresh, name), "reporting again", UP, name)
        self._watchdog.excused -= names

    def _is_fresh(self, name: str) -> bool:
        status = self.driver.status(name)
        return status is not None and time.monotonic() - status.at < FRESH

    def _wait_matched(self, recorded: bool) -> None:
        try:
            self.driver.until(lambda: not unmatched(self.driver, recorded), "matching", MATCH)
        except RunError as error:
            if error.node == "graph":
                raise RunError("graph", unmatched(self.driver, recorded) or error.reason) from None
            raise

    def choose(self, method: str) -> None:
        """Tell the compensator the method; it revises at once from the pass along the target."""
        revision = self._says("revision")
        with self._excuse(COMPENSATOR):
            self.driver.set_parameters(COMPENSATOR, {METHOD: method}, UP)
            self.driver.until(lambda: self._says("revision") != revision, "choosing the method", UP, COMPENSATOR)

    @property
    def repeats(self) -> bool:
        """Whether the compensator goes on with passes until it is finished."""
        return self._says("repeats") == "True"

    def _says(self, key: str, node: str = COMPENSATOR) -> str:
        return self.driver.says(node, key)

    def run_pass(self, name: str) -> PassRun:
        """One pass on a fresh workpiece, recorded to ``out/name``."""
        self.begin_recording(name)
        self.driver.until(self._same_reference, "handing over the reference trajectory", MATCH, ROBOT)
        reference, revision = self._says("reference"), self._says("revision")
        self._watchdog.of_pass = {node: self._says("pid", node) for node in self.children}
        self.driver.transition(CUT, "activate", UP)
        self.driver.transition(ROBOT, "activate", UP)
        self.driver.until(self._pass_complete, "the pass", float("inf"), ROBOT)
        with self._excuse(COMPENSATOR):
            self.driver.until(lambda: self._says("revision") != revision, "revising", UP, COMPENSATOR)
        self._watchdog.of_pass = {}
        wall = float(self._says("wall_s", ROBOT))
        self.driver.transition(ROBOT, "deactivate", UP)
        with self._excuse(CUT):
            self.driver.transition(CUT, "deactivate", UP)
        self.end_recording()
        errors = tuple(float(e) * 1e-6 for e in self._says("remaining_error_um").split())
        finished = self._says("finished") == "True"
        return PassRun(name, self.out / name, reference, wall, errors, finished)

    def _pass_complete(self) -> bool:
        status = self.driver.status(ROBOT)
        return status is not None and status.message.startswith("pass complete")

    def _same_reference(self) -> bool:
        return bool(self._says("reference")) and self._says("reference") == self._says("reference", ROBOT)

    def begin_recording(self, name: str) -> None:
        """Tell the recorder where, and wait until it hears everybody."""
        plant = self.plant
        if plant is not None:
            plant = plant.replace(imperfections=plant.imperfections.replace(first_pass=self.passes))
        self.driver.set_parameters(RECORDER, recording_parameters(self.cell, self.out, name, plant), UP)
        self._wait_matched(recorded=True)
        file = f"{name}/{name}.mcap"
        self.driver.until(lambda: self._says("recording") == file, "naming the recording", MATCH, COMPENSATOR)

    def end_recording(self) -> None:
        """The recorder closes its file; then the next workpiece is made."""
        end = time.monotonic() + CATCH_UP
        self.driver.until(lambda: self._all_recorded() or time.monotonic() > end, "catching up", UP, RECORDER)
        if not self._all_recorded():
            self._hooks.tell(f"recorder: has not received the end of the pass; {NOT_COMPLETE}")
        elif (missing := self._says("missing", RECORDER)) != "0":
            self._hooks.tell(f"recorder: {missing} messages of the pass were lost; {NOT_COMPLETE}")
        self._hooks.pass_recorded()
        with self._excuse(RECORDER):
            self.driver.set_parameters(RECORDER, {"directory": ""}, UP)
        self.passes += 1
        self.renew_workpiece()
        self._wait_matched(recorded=False)

    def renew_workpiece(self) -> None:
        """For the next pass."""
        with self._excuse(CUT):
            self.driver.transition(CUT, "cleanup", UP)
            self.driver.transition(CUT, "configure", UP)

    def _all_recorded(self) -> bool:
        """The recorder has the last message of robot and cut on each of their topics."""
        sent = {**self.driver.counts(ROBOT, "sent_ns"), **self.driver.counts(CUT, "sent_ns")}
        there = self.driver.counts(RECORDER, "latest_ns")
        return bool(sent) and all(there.get(topic, -1) >= stamp for topic, stamp in sent.items())

    def close(self, error: BaseException | None = None) -> None:
        """Stop everything; the recorder last, so that it has the others' last words.

        error: what ends the run early; it is told first, and decides the exit code should the middleware block.
        """
        try:
            self._hooks.leaving(error)
            if self._driver is not None:
                self.driver.close(exit_code(error))  # before the others leave
        finally:
            recorder = {child for node, child in self.children.items() if node == RECORDER}
            stop(set(self.children.values()) - recorder)
            stop(recorder)
            remove_litter()
            self._claimed.close()
            for number, handler in self._handlers.items():
                signal.signal(number, handler)

    def __exit__(self, kind, error, trace) -> None:
        self.close(error)
