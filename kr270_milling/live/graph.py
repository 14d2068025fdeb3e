"""The graph of nodes: processes with a session each, lifecycle, choreography of passes, checks, stop."""

from __future__ import annotations

import contextlib
import errno
import json
import math
import os
import shlex
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParameters
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from kr270_milling.base.arguments import STOPS
from kr270_milling.base.errors import MillingError, one_line
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.cell_file import cell_text, write_cell_file
from kr270_milling.live.ros import topics
from kr270_milling.live.ros.environment import child_environment, keep_to_this_host
from kr270_milling.live.ros.node import ERROR, LOST, NOT_COMPLETE, Silence
from kr270_milling.live.ros.readiness import Report, read_reports
from kr270_milling.recordings.messages.topics import COMPENSATOR, CUT, RECORDER, ROBOT


def already_running(node: str) -> MillingError:
    """Return the error for another graph with the same names of nodes; node: one of them."""
    advice = "stop that graph first, or choose another --namespace or ROS_DOMAIN_ID"
    return MillingError(f"a node {node} already runs in this ROS domain: {advice}")


def own_graph(domain: int, namespace: str) -> socket.socket:
    """Return the right to start the nodes of a namespace in a ROS domain, until it is closed. Raises MillingError.

    If two runs start at once, the first has it. The name of a socket is free again when its process ends, and it
    belongs to the network of this host, as the loopback interface does.
    """
    own = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        own.bind(f"\0kr270_milling/{domain}{namespace}")
    except OSError as error:  # another one: this system has no such names
        if error.errno == errno.EADDRINUSE:
            own.close()
            raise already_running(f"{namespace.rstrip('/')}/{ROBOT}") from None
    return own


class Child:
    """A process with one node or several; its output goes to a log below ``logs``."""

    def __init__(self, nodes: Sequence[str], arguments: Iterable[str], logs: Path):
        self.name = "+".join(nodes)
        self.log = logs / f"{self.name}.log"
        program = nodes if len(nodes) == 1 else ("milling_cell", *nodes)
        command = [sys.executable, "-m", "kr270_milling.live.nodes", *program, *arguments]
        before = signal.pthread_sigmask(signal.SIG_BLOCK, STOPS)  # until the child has its handlers, see live.nodes
        try:
            with open(self.log, "ab") as stream:
                self.process = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=stream,
                    stderr=subprocess.STDOUT,
                    cwd=logs,
                    env=child_environment(),
                    start_new_session=True,
                )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self.ended_at = math.inf  #: [s of the monotonic clock]
        threading.Thread(target=self._wait, daemon=True).start()

    def _wait(self) -> None:
        """Note the end at once: a runner under load looks at its processes late, and two may have ended by then."""
        self.process.wait()
        self.ended_at = time.monotonic()

    @property
    def pid(self) -> int:
        return self.process.pid

    @property
    def alive(self) -> bool:
        return self.ended_at == math.inf

    def why_ended(self) -> str:
        """Return why the process ended, in one sentence."""
        code = self.process.returncode
        if code < 0:
            return f"was ended by {signal.Signals(-code).name}"
        return f"ended with exit code {code} ({self.last_line() or 'it printed nothing'}; see {self.log})"

    def last_line(self) -> str:
        """Return the last line of the log that is not empty."""
        with open(self.log, "rb") as stream:
            stream.seek(max(0, os.fstat(stream.fileno()).st_size - 4096))
            lines = stream.read().decode("utf-8", "replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "")

    def signal(self, number: int) -> None:
        if self.alive:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.pid, number)


def stop(children: Iterable[Child], grace: float = 3.0) -> list[str]:
    """Interrupt all nodes at once and wait; kill those that do not end within ``grace`` [s] and return their names."""
    children = [c for c in children if c.alive]
    for child in children:
        child.signal(signal.SIGINT)
        child.signal(signal.SIGCONT)  # a stopped process handles no signal
    end = time.monotonic() + grace
    while any(child.alive for child in children) and time.monotonic() < end:
        time.sleep(0.01)
    killed = [child for child in children if child.alive]
    for child in killed:
        child.signal(signal.SIGKILL)
        child.process.wait()
    return [child.name for child in killed]


class Driver:
    """A node in a separate context. ``check`` is called some 50 times a second while the node waits, and may raise."""

    def __init__(self, namespace: str, check: Callable[[], None]):
        self.check = check
        self.reports: dict[str, Report] = {}  #: last report by node
        self.arrivals: dict[str, float] = {}  #: node -> arrival of its last report [s of the monotonic clock]
        self.silences: dict[str, Silence] = {}  #: node -> its silence
        self.error: tuple[str, str] | None = None  #: (node, message) of the first ERROR
        self.foreign = ""  #: name of a node that another process also uses; reports of that process are ignored
        self._context = Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node(
            "milling_run",
            namespace=namespace,
            context=self._context,
            use_global_arguments=False,
            start_parameter_services=False,
            enable_rosout=False,
        )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._clients: dict[str, Client] = {}
        self._processes: dict[str, int] = {}  # node -> id of its process
        self.namespace = self.node.get_namespace()
        kind, name, qos = topics.DIAGNOSTICS
        self.node.create_subscription(kind, name, self._on_reports, qos, raw=True)

    def name_of(self, node: str) -> str:
        """Return the fully qualified name of a node or topic."""
        return f"{self.namespace.rstrip('/')}/{node}"

    def expect(self, node: str, pid: int) -> None:
        """Take the reports of this process under the name of the node from now on."""
        self.silences[node] = Silence()
        self._processes[node] = pid

    def _on_reports(self, data: bytes) -> None:
        try:
            reports = read_reports(data)
        except Exception:  # noqa: BLE001 - bytes of another node may be anything
            return
        for node, pid in self._processes.items():
            report = reports.get(self.name_of(node))
            if report is None or "process" not in report.values:
                continue
            if report.values["process"] != str(pid):
                self.foreign = self.name_of(node)
                continue
            self.reports[node], self.arrivals[node] = report, time.monotonic()
            self.silences[node].end()
            if report.level == ERROR[0] and self.error is None:
                self.error = node, report.message

    def value(self, node: str, key: str) -> str | None:
        """Return a value of the last report of a node; None without a report or without the value."""
        report = self.reports.get(node)
        return None if report is None else report.values.get(key)

    def until(self, condition: Callable[[], object], what: str | Callable, deadline: float, node: str = "graph"):
        """Wait for a condition and return its value; raises MillingError after the deadline [s].

        what: words for the condition, or a function that returns the reason.
        """
        end = time.monotonic() + deadline
        while not (value := condition()):
            self.check()
            if time.monotonic() > end:
                reason = what() if callable(what) else f"{what} took more than {deadline:g} s"
                raise MillingError(f"{node}: {reason}")
            self.spin()
        return value

    def spin(self) -> None:
        self._executor.spin_once(timeout_sec=0.02)  # then the processes are checked

    def _call(self, nodes: Sequence[str], kind: type, service: str, request, what: str, deadline: float) -> dict:
        """Call a service of several nodes at once and return the responses by node.

        what: words for the call, for the error after the deadline [s].
        """
        futures = {}
        for node in nodes:
            name = f"{self.name_of(node)}/{service}"
            if name not in self._clients:
                self._clients[name] = self.node.create_client(kind, name)
            self.until(self._clients[name].service_is_ready, f"discovery of the service {service}", deadline, node)
            futures[node] = self._clients[name].call_async(request)
        for node, future in futures.items():
            self.until(future.done, what, deadline, node)
        return {node: future.result() for node, future in futures.items()}

    def transition(self, name: str, *nodes: str, deadline: float) -> None:
        """Request a lifecycle transition of several nodes at once; raises MillingError where it fails."""
        change = Transition(id=getattr(Transition, f"TRANSITION_{name.upper()}"), label=name)
        request = ChangeState.Request(transition=change)
        for node, response in self._call(nodes, ChangeState, "change_state", request, name, deadline).items():
            if not response.success:
                self.until(lambda: self.error, f"the reason for the failed {name}", 1.0, node)
                self.check()

    def set_parameters(self, node: str, values: Mapping[str, object], deadline: float) -> None:
        """Set parameters of a node, one after another; raises MillingError where the node refuses a value."""
        parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        request = SetParameters.Request(parameters=parameters)
        what = f"setting {', '.join(values)}"
        (response,) = self._call([node], SetParameters, "set_parameters", request, what, deadline).values()
        for result in response.results:
            if not result.successful:
                raise MillingError(f"{node}: {result.reason}")

    def nodes(self) -> set[str]:
        """Return the fully qualified names of the nodes in this ROS domain."""
        return {f"{space.rstrip('/')}/{name}" for name, space in self.node.get_node_names_and_namespaces()}


UP = 300.0  # [s] for a node to start, to compile at its first use on a busy machine, or to revise a long trajectory
QUIET = 1.0  # [s] without a report in mid-pass, after which the run prints a warning
CELL, PLANNER = (ROBOT, CUT), (COMPENSATOR, RECORDER)  # the two processes of a composed graph
NODES = (*CELL, *PLANNER)


class Graph:
    """Context manager: starts the nodes, and stops them in any case.

    out: an existing directory for cell.yaml, logs and recordings; composed: robot and cut in one process, compensator
    and recorder in another; plant: the cell of robot and cut, where it differs from the cell that the compensator
    plans with. Raises MillingError. The process itself stays in the ROS graph until it ends: Fast DDS
    sometimes blocks a process that leaves (eProsima/Fast-DDS#6502).
    """

    driver: Driver  #: the node of this process, from ``start`` on

    def __init__(self, cell: Cell, out: Path, namespace: str = "", composed: bool = False, plant: Cell | None = None):
        self.cell = cell
        self.plant = plant
        self.out = Path(out).resolve()
        self.children: dict[str, Child] = {}  #: node -> its process
        self.passes = 0  #: number of recorded passes
        self._composed = composed
        self._namespace = namespace
        self._in_pass = False
        self._recording = ""  # file of the present pass
        self._judged = 0.0  # time of the first error [s of the monotonic clock]
        self._lock: socket.socket | None = None
        self._signals: list[int] = []
        self._handlers: dict[int, Any] = {}

    def __enter__(self) -> Graph:
        try:
            return self.start()
        except BaseException:
            self.stop()
            raise

    def __exit__(self, kind, error, trace) -> None:
        self.stop()

    def start(self) -> Graph:
        """Start the nodes and configure robot, cut and recorder; the caller calls ``stop`` in any case."""
        started = time.monotonic()
        keep_to_this_host()
        (self.out / "log").mkdir(exist_ok=True)
        write_cell_file(self.cell, self.out / "cell.yaml")
        if self.plant is not None:
            write_cell_file(self.plant, self.out / "plant.yaml")
        if threading.current_thread() is threading.main_thread():
            for number in STOPS:
                self._handlers[number] = signal.signal(number, lambda caught, _: self._signals.append(caught))
        self.driver = Driver(self._namespace, self.check)
        self._lock = own_graph(self.driver.node.context.get_domain_id(), self.driver.namespace)
        self._refuse_second()
        self._start_nodes()
        self.driver.transition("configure", *CELL, RECORDER, deadline=UP)
        self.up_s = time.monotonic() - started
        return self

    def _refuse_second(self) -> None:
        """Raise MillingError before the nodes start: their first messages would disturb nodes started by hand."""
        end = time.monotonic() + 0.5  # [s] to discover another graph: five announcements of the profile
        while time.monotonic() < end:
            self.check()
            self.driver.spin()
        others = sorted(self.driver.nodes() & set(map(self.driver.name_of, NODES)))
        if others:
            raise already_running(others[0])

    def _start_nodes(self) -> None:
        cuts = self.out / ("cell.yaml" if self.plant is None else "plant.yaml")
        tracked = () if self.plant is None else ("-p", f"plant:={cuts}")
        space = self.driver.namespace  # the recording is limited to it and the reports of all nodes
        records = ("-p", "autostart:=false", *(() if space == "/" else ("-p", f"topics:=[{space}/*,/diagnostics]")))
        for nodes in (CELL, PLANNER) if self._composed else ((node,) for node in NODES):
            parameters = cuts if nodes[0] in CELL else self.out / "cell.yaml"
            more = [*(tracked if COMPENSATOR in nodes else ()), *(records if RECORDER in nodes else ())]
            if space != "/":
                more += ["-r", f"__ns:={space}"]
            words = ["--ros-args", "-p", f"cell_file:={json.dumps(str(parameters))}", *more]
            child = Child(nodes, words, self.out / "log")
            for node in nodes:
                self.children[node] = child
                self.driver.expect(node, child.pid)
        self.driver.until(lambda: len(self.driver.reports) == len(NODES), "coming up", UP)
        if self.driver.foreign:
            raise already_running(self.driver.foreign)

    def check(self) -> None:
        """Called some 50 times a second while the run waits; raises when the run cannot continue."""
        if self._signals:
            if self._signals[0] != signal.SIGINT:
                raise SystemExit(128 + self._signals[0])
            raise KeyboardInterrupt
        ended = [node for node, child in self.children.items() if not child.alive]
        if ended:  # the others may have ended because of the first
            first = min(ended, key=lambda node: self.children[node].ended_at)
            raise MillingError(f"{first}: {self.children[first].why_ended()}")
        silences = {node: self.driver.silences[node] for node in self.children if self._in_pass}
        silent = {node: silence.seconds() for node, silence in silences.items()}
        longest = max(silent, key=silent.__getitem__, default="")
        if longest and silent[longest] > LOST:
            raise MillingError(f"{longest}: has not reported for {silent[longest]:.0f} s")
        if self.children and self.driver.error:
            self._blame(*self.driver.error)
        for node, silence in silences.items():
            if silence.is_due(silent[node], QUIET):
                self.warn(f"{node}: has not reported for {QUIET:g} s; waiting")

    def _blame(self, node: str, error: str) -> None:
        """Raise MillingError for a node that is silent, or for the one with the error where all others still report.

        A node reports the silence of its partner. On a busy machine the reports are late, so each node has time for
        one more.
        """
        now = time.monotonic()
        self._judged = self._judged or now
        silent = [name for name in self.children if self.driver.arrivals.get(name, 0.0) < self._judged]
        if not self._in_pass or not silent:
            raise MillingError(f"{node}: {error}")
        if now - self._judged > LOST / 2:
            first = min(silent, key=lambda name: self.driver.arrivals.get(name, 0.0))
            silence = now - self.driver.arrivals.get(first, now)
            raise MillingError(f"{first}: has not reported for {silence:.0f} s")

    def warn(self, sentence: str) -> None:
        """Print a warning while the run continues."""
        print(f"kr270_milling: {one_line(sentence)}", file=sys.stderr)

    def choose(self, method: str) -> None:
        """Set the method of the compensator, which revises at once from the pass along the target."""
        revision = self._value("revision")
        self.driver.set_parameters(COMPENSATOR, {"compensation.method": method}, UP)
        self.driver.until(lambda: self._value("revision") != revision, "choosing the method", UP, COMPENSATOR)

    @property
    def repeats(self) -> bool:
        """Return whether the method continues with passes until the compensator is finished."""
        return self._value("repeats") == "True"

    def _value(self, key: str, node: str = COMPENSATOR) -> str | None:
        return self.driver.value(node, key)

    def run_pass(self, name: str) -> tuple[Path, float, tuple[float, ...], bool]:
        """Run one pass on a fresh workpiece and record it to ``out/name``.

        Returns the recording, the wall time from the first exchange to the last [s], the remaining error of every pass
        of this method so far [m], and whether the compensator has reached its limit.
        """
        until = self.driver.until
        self.begin_recording(name)
        self.driver.transition("activate", CUT, deadline=UP)
        waiting = "the compensator does not know the recording"
        until(
            lambda: self._value("recording") == self._recording and not self._value("waiting_for"),
            lambda: self._value("waiting_for") or waiting,
            30.0,  # [s] to discover each other
        )
        revision, passes = self._value("revision"), self._value("passes", ROBOT)
        self.driver.transition("activate", ROBOT, deadline=UP)
        self._in_pass = True
        until(lambda: self._value("passes", ROBOT) != passes, "the pass", float("inf"), ROBOT)
        self._in_pass = False
        until(lambda: self._value("revision") != revision, "revising", UP, COMPENSATOR)
        wall = float(self._value("wall_s", ROBOT) or 0.0)
        self.driver.transition("deactivate", *CELL, deadline=UP)
        self.end_recording()
        errors = tuple(e * 1e-6 for e in json.loads(self._value("remaining_error_um") or "[]"))
        return self.out / name, wall, errors, self._value("finished") == "True"

    def begin_recording(self, name: str) -> None:
        """Open the file of the recorder."""
        attach = [self.out / "cell.yaml", *self.cell.path.files]
        if self.plant is not None:
            first = self.plant.imperfections.replace(first_pass=self.passes)
            attach.append(self.out / "log" / name / "plant.yaml")
            attach[-1].parent.mkdir(exist_ok=True)
            attach[-1].write_text(cell_text(self.plant.replace(imperfections=first)), encoding="utf-8")
        # the directory starts the recording, so it comes last
        values = {"attach": [*map(str, attach)], "command": shlex.join(sys.argv), "directory": str(self.out / name)}
        self.driver.set_parameters(RECORDER, values, UP)
        self.driver.transition("activate", RECORDER, deadline=UP)
        self._recording = f"{name}/{name}.mcap"

    def end_recording(self) -> None:
        """Close the file of the recorder, then create the next workpiece."""
        self.driver.transition("deactivate", RECORDER, deadline=UP)
        nodes = (*CELL, RECORDER)
        self.driver.until(lambda: all(self._value("state", node) == "inactive" for node in nodes), "deactivate", UP)
        for node in nodes:
            if NOT_COMPLETE in self.driver.reports[node].message:
                self.warn(f"{node}: {self.driver.reports[node].message}")
        self.passes += 1
        for transition in ("cleanup", "configure"):  # a fresh workpiece for the next pass
            self.driver.transition(transition, CUT, deadline=UP)

    def stop(self) -> None:
        """Stop every node, the recorder last, so that it receives the last messages of the others."""
        recorder = {child for node, child in self.children.items() if node == RECORDER}
        stop(set(self.children.values()) - recorder)
        stop(recorder)
        if self._lock is not None:
            self._lock.close()
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
