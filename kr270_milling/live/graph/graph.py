"""The four nodes as processes: start, lifecycle, passes, checks, stop."""

from __future__ import annotations

import contextlib
import functools
import os
import signal
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kr270_milling.cell.cell import Cell
from kr270_milling.live.graph.driver import Driver
from kr270_milling.live.graph.processes import (
    Child,
    RunError,
    recording_parameters,
    ros_arguments,
    stop,
    write_cell_file,
)
from kr270_milling.live.graph.watchdog import (
    COMPENSATOR,
    CUT,
    RECORDER,
    ROBOT,
    AlreadyRunning,
    Hooks,
    Watchdog,
    unmatched,
)
from kr270_milling.live.ros.environment import keep_to_this_host

__all__ = ["CELL", "NOT_COMPLETE", "PLANNER", "Graph", "RunValues"]

UP = 60.0  # [s] for a node to start, to compile at its first use, or to revise a long trajectory
MATCH = 30.0  # [s] for the nodes to discover each other
DISCOVERY = 0.5  # [s] for this process to discover another graph, five announcements of the profile
FRESH = 1.0  # [s] since the last report of a node that reports
CATCH_UP = 5.0  # [s] for a recorder at the end of a pass to request the messages that it missed
METHOD = "compensation.method"
CELL, PLANNER = (ROBOT, CUT), (COMPENSATOR, RECORDER)  # the two processes of a composed graph
NOT_COMPLETE = "its recording is not complete"


@dataclass(frozen=True)
class RunValues:
    """Values of one pass that are not in its recording."""

    name: str
    recording: Path
    reference: str  #: fingerprint of the reference trajectory
    wall_s: float  #: from the first exchange to the last [s]
    errors: tuple[float, ...]  #: remaining error of every pass of this method so far [m], computed by the compensator
    finished: bool  #: the compensator has reached its limit


class Graph:
    """Context manager: starts the nodes, and stops them in any case.

    out: an existing directory for cell.yaml, logs and recordings; composed: robot and cut in one process, compensator
    and recorder in another; plant: the cell of robot and cut, where it differs from the cell that the compensator
    plans with. Raises RunError, AlreadyRunning. A program that ends behind the graph calls ``start`` and ``stop``
    only: Fast DDS sometimes blocks while a process leaves the graph (eProsima/Fast-DDS#6502).
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
        self.children: dict[str, Child] = {}
        self.passes = 0  #: number of recorded passes
        self.spawned: dict[str, tuple] = {}  #: name of a process -> its nodes, parameter file and further arguments
        self._stagger = stagger
        self._composed = composed
        self._namespace = namespace
        self._hooks = hooks or Hooks()
        self._watchdog = Watchdog({ROBOT, CUT, COMPENSATOR, RECORDER}, self._hooks.warn)
        self._signals: list[int] = []
        self._handlers: dict[int, Any] = {}

    def __enter__(self) -> Graph:
        try:
            return self.start()
        except BaseException:
            self.close()
            raise

    def start(self) -> Graph:
        """Start the nodes and configure robot and cut; the caller calls ``stop`` in any case."""
        started = time.monotonic()
        keep_to_this_host()
        (self.out / "log").mkdir(exist_ok=True)
        write_cell_file(self.cell, self.out / "cell.yaml")
        if self.plant is not None:
            write_cell_file(self.plant, self.out / "plant.yaml")
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._handlers[number] = signal.signal(number, lambda caught, _: self._signals.append(caught))
        self._driver = Driver(self._namespace, self.check)
        self._refuse_second()
        self._start_nodes(started)
        return self

    @property
    def driver(self) -> Driver:
        """The node of this process, while the graph is up."""
        if self._driver is None:
            raise RunError("graph", "is not up")
        return self._driver

    def _refuse_second(self) -> None:
        """Raise AlreadyRunning before the nodes start: their first messages would disturb the other graph."""
        self._pause(DISCOVERY)
        others = sorted(self.driver.nodes() & set(map(self.driver.name_of, (*CELL, *PLANNER))))
        if others:
            raise AlreadyRunning(others[0])

    def _start_nodes(self, started: float) -> None:
        cuts = self.out / ("cell.yaml" if self.plant is None else "plant.yaml")
        tracked = () if self.plant is None else ("-p", f"plant:={cuts}")
        records = ("-p", "autostart:=false", *self._recorded_topics())
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
        """Keep robot and cut on one core, and compensator and recorder on the others.

        Robot and cut work in turns. To wake up a process on another core took as long as the whole exchange.
        """
        cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
        if len(cores) < 2:
            return
        own = sorted(cores)[os.getpid() % len(cores)]
        for node, child in self.children.items():
            child.keep_to({own} if node in CELL else cores - {own})

    def _pause(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.check()
            self.driver.spin()

    def _recorded_topics(self) -> tuple[str, ...]:
        """Return arguments that limit the recording to the namespace and the reports of all nodes."""
        space = self.driver.namespace
        return () if space == "/" else ("-p", f"topics:=[{space}/*,/diagnostics]")

    def spawn(self, nodes: tuple[str, ...], parameters: Path, *arguments: str) -> None:
        """Start a process with one node or several; arguments: those after ``--ros-args``."""
        child = Child(nodes, ros_arguments(parameters, self.driver.namespace, *arguments), self.out / "log")
        self.spawned[child.name] = nodes, parameters, arguments
        for node in nodes:
            self.children[node] = child
            self.driver.expect(node, child.pid)

    def check(self) -> None:
        """Called some 50 times a second while the run waits; raises when the run cannot continue."""
        if self._signals:
            if self._signals[0] == signal.SIGTERM:
                raise SystemExit(128 + signal.SIGTERM)
            raise KeyboardInterrupt
        if self._driver is not None:
            self._hooks.before_check()
            self._watchdog.check(self.driver, self.children)

    @contextlib.contextmanager
    def _excuse(self, node: str):
        """Expect no report of a node during a long computation, nor of a node in the same process."""
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
        """Set the method of the compensator, which revises at once from the pass along the target."""
        revision = self._value("revision")
        with self._excuse(COMPENSATOR):
            self.driver.set_parameters(COMPENSATOR, {METHOD: method}, UP)
            self.driver.until(lambda: self._value("revision") != revision, "choosing the method", UP, COMPENSATOR)

    @property
    def repeats(self) -> bool:
        """Whether the method continues with passes until the compensator is finished."""
        return self._value("repeats") == "True"

    def _value(self, key: str, node: str = COMPENSATOR) -> str:
        return self.driver.value(node, key)

    def run_pass(self, name: str) -> RunValues:
        """Run one pass on a fresh workpiece and record it to ``out/name``."""
        self.begin_recording(name)
        self.driver.until(self._same_reference, "transfer of the reference trajectory", MATCH, ROBOT)
        reference, revision = self._value("reference"), self._value("revision")
        self._watchdog.process_ids = {node: self._value("pid", node) for node in self.children}
        self.driver.transition(CUT, "activate", UP)
        self.driver.transition(ROBOT, "activate", UP)
        self.driver.until(self._pass_complete, "the pass", float("inf"), ROBOT)
        with self._excuse(COMPENSATOR):
            self.driver.until(lambda: self._value("revision") != revision, "revising", UP, COMPENSATOR)
        self._watchdog.process_ids = {}
        wall = float(self._value("wall_s", ROBOT))
        self.driver.transition(ROBOT, "deactivate", UP)
        with self._excuse(CUT):
            self.driver.transition(CUT, "deactivate", UP)
        self.end_recording()
        errors = tuple(float(e) * 1e-6 for e in self._value("remaining_error_um").split())
        finished = self._value("finished") == "True"
        return RunValues(name, self.out / name, reference, wall, errors, finished)

    def _pass_complete(self) -> bool:
        status = self.driver.status(ROBOT)
        return status is not None and status.message.startswith("pass complete")

    def _same_reference(self) -> bool:
        return bool(self._value("reference")) and self._value("reference") == self._value("reference", ROBOT)

    def begin_recording(self, name: str) -> None:
        """Set the directory of the recorder, and wait until it is matched with every publisher."""
        plant = self.plant
        if plant is not None:
            plant = plant.replace(imperfections=plant.imperfections.replace(first_pass=self.passes))
        self.driver.set_parameters(RECORDER, recording_parameters(self.cell, self.out, name, plant), UP)
        self._wait_matched(recorded=True)
        file = f"{name}/{name}.mcap"
        self.driver.until(lambda: self._value("recording") == file, "naming the recording", MATCH, COMPENSATOR)

    def end_recording(self) -> None:
        """Close the file of the recorder, then create the next workpiece."""
        end = time.monotonic() + CATCH_UP
        self.driver.until(lambda: self._all_recorded() or time.monotonic() > end, "catching up", UP, RECORDER)
        if not self._all_recorded():
            self._hooks.warn(f"recorder: has not received the end of the pass; {NOT_COMPLETE}")
        elif (missing := self._value("missing", RECORDER)) != "0":
            self._hooks.warn(f"recorder: {missing} messages of the pass were lost; {NOT_COMPLETE}")
        self._hooks.pass_recorded()
        with self._excuse(RECORDER):
            self.driver.set_parameters(RECORDER, {"directory": ""}, UP)
        self.passes += 1
        self.renew_workpiece()
        self._wait_matched(recorded=False)

    def renew_workpiece(self) -> None:
        """Create a fresh workpiece for the next pass."""
        with self._excuse(CUT):
            self.driver.transition(CUT, "cleanup", UP)
            self.driver.transition(CUT, "configure", UP)

    def _all_recorded(self) -> bool:
        """Return whether the recorder has the last message of robot and cut on each of their topics."""
        sent = {**self.driver.counts(ROBOT, "sent_ns"), **self.driver.counts(CUT, "sent_ns")}
        there = self.driver.counts(RECORDER, "latest_ns")
        return bool(sent) and all(there.get(topic, -1) >= stamp for topic, stamp in sent.items())

    def stop(self) -> None:
        """Stop every node, the recorder last, so that it receives the last messages of the others."""
        recorder = {child for node, child in self.children.items() if node == RECORDER}
        stop(set(self.children.values()) - recorder)
        stop(recorder)
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def close(self) -> None:
        """Stop every node and leave the graph."""
        self.stop()
        if self._driver is not None:
            self._driver.close()
            self._driver = None

    def __exit__(self, kind, error, trace) -> None:
        self.close()
