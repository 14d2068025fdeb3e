"""The four nodes as processes: started, driven through the lifecycle, watched, and always stopped again."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from kr270_milling.base.errors import MillingError
from kr270_milling.base.process import exit_code
from kr270_milling.cell.cell import Cell
from kr270_milling.graph.arguments import ros_arguments, write_recorder_parameters
from kr270_milling.graph.driver import Driver
from kr270_milling.graph.matching import COMPENSATOR, CUT, RECORDER, ROBOT, unmatched
from kr270_milling.graph.processes import Child, RunError, remove_litter, stop
from kr270_milling.ros.cell_file import write_cell
from kr270_milling.ros.environment import keep_to_this_host
from kr270_milling.ros.node import LOST

__all__ = ["NOT_COMPLETE", "LOST", "AlreadyRunning", "Graph", "PassRun"]

UP = 60.0  # [s] for a node to come up, to compile at its first use, or to revise a long trajectory
MATCH = 10.0  # [s] for the nodes to find each other
QUIET = 1.0  # [s] without a report after which this is told
HELD_UP = 0.5  # [s] between two looks of this process, after which the reports that wait are heard first
CATCH_UP = 5.0  # [s] that a recorder has at the end of a pass to ask for what it was too slow for
METHOD = "compensation.method"
TOGETHER = "milling_cell"  # robot and cut in one process
NOT_COMPLETE = "its recording is not complete"


class AlreadyRunning(MillingError):
    """Another graph has the same node names; node is one of them."""

    def __init__(self, node: str):
        self.node = node
        super().__init__(
            f"a node {node} already runs in this ROS domain: stop that graph first, or choose another --namespace or "
            "ROS_DOMAIN_ID"
        )


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

    out: an existing directory that gets cell.yaml, logs and recordings; composed: robot and cut in one process. Raises
    RunError, AlreadyRunning.
    """

    def __init__(
        self,
        cell: Cell,
        out: Path,
        namespace: str = "",
        extra: tuple[str, ...] = (),
        stagger: float = 0.0,
        composed: bool = False,
    ):
        self.cell, self.out = cell, Path(out).resolve()
        self.extra, self._stagger, self._composed = extra, stagger, composed
        self.children: dict[str, Child] = {}
        self.ended: list[Child] = []  # recorders of the passes that are done
        self._namespace, self._signals, self._handlers = namespace, [], {}
        self._excused: set[str] = {ROBOT, CUT, COMPENSATOR, RECORDER}  # may be silent now
        self._up = False
        self._of_pass: dict[str, str] = {}  # process id of each node when the pass began
        self._looked, self._hear_until, self._quiet = time.monotonic(), 0.0, set()

    def __enter__(self) -> Graph:
        started = time.monotonic()
        keep_to_this_host()
        (self.out / "log").mkdir(exist_ok=True)
        write_cell(self.cell, self.out / "cell.yaml")
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._handlers[number] = signal.signal(number, lambda caught, _: self._signals.append(caught))
        self.driver = None
        try:
            self.driver = Driver(self._namespace, self.check)
            self._start(started)
        except BaseException as error:
            self.close(exit_code(error))
            raise
        return self

    def _start(self, started: float) -> None:
        if self._composed:
            self._spawn(TOGETHER, self.out / "cell.yaml", *self.extra)
            self.children[ROBOT] = self.children[CUT] = self.children.pop(TOGETHER)
        for name in [name for name in (ROBOT, CUT, COMPENSATOR) if name not in self.children]:
            self._spawn(name, self.out / "cell.yaml", *self.extra)
            self._pause(self._stagger)
        nodes = (ROBOT, CUT, COMPENSATOR)
        self.driver.until(lambda: all(map(self.driver.status, nodes)), "coming up", UP)
        self.driver.transitions([(ROBOT, "configure"), (CUT, "configure")], UP)
        self._excused = {RECORDER}
        self._up = True
        self._wait_matched(recorded=False)
        self.up_s = time.monotonic() - started

    def _pause(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.check()
            self.driver.spin()

    def _spawn(self, name: str, parameters: Path, *arguments: str) -> None:
        arguments = ros_arguments(parameters, self.driver.namespace, *arguments)
        self.driver.statuses.pop(self.driver.name_of(name), None)
        self.children[name] = Child(name, arguments, self.out / "log" / f"{name}.log")

    def check(self) -> None:
        """Called all the time while something is waited for; raises when the graph cannot go on."""
        if self._signals:
            if self._signals[0] == signal.SIGTERM:
                raise SystemExit(128 + signal.SIGTERM)
            raise KeyboardInterrupt
        if self.driver is None:
            return
        ours = {self.driver.name_of(name): child for name, child in self.children.items()}
        for name, child in ours.items():
            status = self.driver.statuses.get(name)
            if status is not None and status.values.get("pid", str(child.pid)) != str(child.pid):
                raise AlreadyRunning(name)
        for name, child in self.children.items():
            if not child.alive:
                raise RunError(name, child.why_ended())
        for name, message in self.driver.errors:
            if name in ours:
                raise RunError(name.rpartition("/")[2], message)
        for name, pid in self._of_pass.items():
            if self._says("pid", name) not in ("", pid):
                raise RunError(name, "was restarted in mid-pass")
        self._check_silence(time.monotonic())

    def _check_silence(self, now: float) -> None:
        if now - self._looked > HELD_UP:  # it was us who did not listen
            self._hear_until = now + HELD_UP
        self._looked = now
        if now < self._hear_until:
            return
        silences = {name: self._silent(name, now) for name in set(self.children) - self._excused}
        if len(silences) > 1 and max(silences.values()) > LOST and min(silences.values()) > LOST - HELD_UP:
            self.driver.stuck = True
            what = f"no node has been heard of for {LOST - HELD_UP:g} s: the middleware of this process may be blocked"
            raise RunError("graph", what)
        for name, silent in silences.items():
            if silent > LOST:
                raise RunError(name, f"has not been heard of for {LOST:g} s")
            if silent > QUIET and name not in self._quiet:
                self.tell(f"{name}: has not been heard of for {QUIET:g} s; waiting")
            (self._quiet.add if silent > QUIET else self._quiet.discard)(name)

    def _silent(self, name: str, now: float) -> float:
        status = self.driver.status(name)
        return 0.0 if status is None else now - status.at

    def tell(self, sentence: str) -> None:
        """What the user should know while the run goes on."""
        print(f"kr270_milling: {sentence}", file=sys.stderr)

    @contextlib.contextmanager
    def _excuse(self, *names: str):
        """Nodes that are busy with something long are not expected to report."""
        self._excused |= set(names)
        yield
        self.driver.spin()
        for name in names:
            self.driver.until(lambda n=name: self._is_fresh(n), "reporting again", UP, name)
        self._excused -= set(names)

    def _is_fresh(self, name: str) -> bool:
        status = self.driver.status(name)
        return status is not None and time.monotonic() - status.at < QUIET

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
            self.driver.set_text(COMPENSATOR, METHOD, method, UP)
            self.driver.until(lambda: self._says("revision") != revision, "choosing the method", UP, COMPENSATOR)

    @property
    def repeats(self) -> bool:
        """Whether the compensator goes on with passes until it is finished."""
        return self._says("repeats") == "True"

    def _says(self, key: str, node: str = COMPENSATOR) -> str:
        status = self.driver.status(node)
        return "" if status is None else status.values.get(key, "")

    def run_pass(self, name: str) -> PassRun:
        """One pass on a fresh workpiece, recorded to ``out/name``."""
        self.begin_recording(name)
        self.driver.until(self._same_reference, "handing over the reference trajectory", MATCH, ROBOT)
        for child in self.children.values():
            child.note_shared()  # of a node that is killed later this cannot be found out any more
        reference, revision = self._says("reference"), self._says("revision")
        self._of_pass = {node: self._says("pid", node) for node in self.children}
        self.driver.transition(CUT, "activate", UP)
        self.driver.transition(ROBOT, "activate", UP)
        self.driver.until(self._pass_complete, "the pass", float("inf"), ROBOT)
        with self._excuse(COMPENSATOR):
            self.driver.until(lambda: self._says("revision") != revision, "revising", UP, COMPENSATOR)
        self._of_pass = {}
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
        return status.message.startswith("pass complete")

    def _same_reference(self) -> bool:
        return bool(self._says("reference")) and self._says("reference") == self._says("reference", ROBOT)

    def begin_recording(self, name: str) -> None:
        """Start the recorder of a pass and wait until it hears everybody."""
        self._spawn(RECORDER, write_recorder_parameters(self.cell, self.out, name, self.driver.namespace))
        with self._excuse(RECORDER):
            self.driver.until(lambda: self.driver.status(RECORDER), "coming up", UP, RECORDER)
        self._wait_matched(recorded=True)

    def end_recording(self) -> None:
        """The recorder closes its file while the next workpiece is made."""
        end = time.monotonic() + CATCH_UP
        self.driver.until(lambda: self._all_recorded() or time.monotonic() > end, "catching up", UP, RECORDER)
        if not self._all_recorded():
            self.tell(f"recorder: has not received the end of the pass; {NOT_COMPLETE}")
        elif self._says("missing", RECORDER) != "0":
            self.tell(f"recorder: {self._says('missing', RECORDER)} messages of the pass were lost; {NOT_COMPLETE}")
        recorder = self.children.pop(RECORDER)
        self._excused.add(RECORDER)
        self.ended.append(recorder)
        recorder.note_shared()
        recorder.signal(signal.SIGINT)
        self.renew_workpiece()
        self.driver.until(lambda: not recorder.alive, "closing its file", UP, RECORDER)
        if recorder.process.returncode != 0:
            raise RunError(RECORDER, recorder.why_ended())
        self._wait_matched(recorded=False)

    def renew_workpiece(self) -> None:
        """For the next pass."""
        with self._excuse(CUT):
            self.driver.transition(CUT, "cleanup", UP)
            self.driver.transition(CUT, "configure", UP)

    def _all_recorded(self) -> bool:
        """The recorder has the last pose and wrench."""
        latest = self.driver.status(RECORDER).counts("latest_ns")
        last = float(self._says("pass_time_s", ROBOT)) * 1e9 - 1000  # told in microseconds
        return all(latest.get(self.driver.name_of(t), -1) >= last for t in ("tool_pose", "wrench"))

    def close(self, code: int = 0) -> None:
        """Stop everything; the recorder last, so that it has the others' last words.

        code: of this process, should the middleware block while it leaves.
        """
        recorders = [*self.ended, *filter(None, [self.children.pop(RECORDER, None)])]  # one may be closing its file
        try:
            if self.driver is not None:
                self.driver.close(code)  # before the others leave
        finally:
            stop(set(self.children.values()))
            stop(recorders)
            remove_litter([*self.children.values(), *recorders])
            for number, handler in self._handlers.items():
                signal.signal(number, handler)

    def __exit__(self, kind, error, trace) -> None:
        self.close(exit_code(error))
