"""Fixtures of the ROS tests: a separate domain, a context, nodes stepped by hand, conditions with deadlines."""

from __future__ import annotations

import os
import signal

os.environ.setdefault("OMP_NUM_THREADS", "1")  # small matrices only, and some tests run five processes on two cores
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a shell sets this for background processes
    signal.signal(signal.SIGINT, signal.default_int_handler)  # the tested programs must receive it

import contextlib
import gc
import io
import json
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from hostile import SHORT
from hypothesis import settings
from json_keys import answer_of, every_answer_is_in_the_table
from ros_domain import DISCOVERY, ROOT, own_domain, own_turn

#: every process that a test starts runs this checkout, not an installed package
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
gc.set_threshold(20_000, 20)  # as in a command; the search for garbage took 7 % of the tests
LIMIT = 60.0  # [s] for what does not happen, on a busy machine too


def pytest_addoption(parser):
    parser.addoption("--book", action="store_true", help="run the checks of the verification book, print its table")


def pytest_configure(config):
    settings.register_profile("suite", deadline=None)  # a busy machine may take long for one example
    settings.load_profile("suite")
    config.addinivalue_line("markers", "book: a row of the verification book (test/book)")
    if config.getoption("--book"):
        config.option.markexpr = "book"
    if os.environ.get("PYTEST_XDIST_WORKER") == "gw1":
        compile_engagement()


def pytest_collection_finish() -> None:
    if os.environ.get("PYTEST_XDIST_WORKER") == "gw0":
        compile_teeth()


# Of two workers each compiles half of what most tests need, and not the other's half again. The second compiles before
# it collects the tests: meanwhile the first collects them, and keeps their byte code.
def compile_engagement() -> None:
    """Compile the cut and the check of a flat tool and of a ball."""
    from samples.small_part import compile_cut

    from kr270_milling.decide.check import check

    check(compile_cut("engagement"))
    compile_cut("engagement", "tool.type=ball")


def compile_teeth() -> None:
    """Compile the cut and the check of a leaning tool, then the model of the teeth and the learning."""
    from samples.small_part import LEANING, compile_cut

    from kr270_milling.cell.jobs import compensated, simulate
    from kr270_milling.decide.check import check

    check(compile_cut("engagement", gcode=LEANING))
    cell = compile_cut("teeth")
    compensated(cell, simulate(cell), "learned")


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session) -> None:
    """A run whose workers all crashed before the first test is no success."""
    results = session.config.pluginmanager.get_plugin("terminalreporter")
    if results is None or "PYTEST_XDIST_WORKER" in os.environ or session.config.option.collectonly:
        return
    if session.exitstatus == pytest.ExitCode.OK and not (results.stats.get("passed") or results.stats.get("skipped")):
        session.exitstatus = pytest.ExitCode.NO_TESTS_COLLECTED


def pytest_terminal_summary(terminalreporter, config):
    if config.getoption("--book"):
        import book

        terminalreporter.write_line(book.markdown(book.ROWS))


def pytest_collection_modifyitems(items) -> None:
    """The first of two workers starts with the tests of graphs, the second with those of nodes in this process.

    Each kind takes turns (``own_turn``); a worker takes over the end of the other's share, which is of neither kind.
    The tests of the demo follow each other, so that one worker runs the demo.
    """
    kinds: dict[str, list] = {"processes": [], "nodes": [], "": []}
    for item in sorted(items, key=lambda item: "demo" not in item.fixturenames):
        kinds[kind_of(item.fixturenames)].append(item)
    before = max(0, len(items) // 2 - len(kinds["processes"]))
    items[:] = kinds["processes"] + kinds[""][:before] + kinds["nodes"] + kinds[""][before:]


def kind_of(fixtures) -> str:
    """How a test uses a ROS domain: by processes, by nodes in this one, or not."""
    if "ros_environment" in fixtures:
        return "processes"
    return "nodes" if "domain" in fixtures else ""


@pytest.fixture
def domain(request):
    """A ROS domain id that no other test run on this machine uses now."""
    with own_turn(kind_of(request.fixturenames)), own_domain() as number:
        yield number


@pytest.fixture
def ros_environment(domain, monkeypatch):
    """For processes that a test starts: the domain, the discovery that is shipped."""
    for name in DISCOVERY:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    return dict(os.environ)


@pytest.fixture(scope="session", autouse=True)
def no_lines_of_progress():
    """On a busy machine a command may print lines of progress; the tests look at its other lines."""
    from kr270_milling.show.commands import console

    console.LINE_PERIOD = 1e6


@pytest.fixture(scope="session", autouse=True)
def every_json_answer():
    """A key without a row in guide/contributing/json.md fails the test that runs the command."""
    with every_answer_is_in_the_table():
        yield


@pytest.fixture
def few_robots(monkeypatch):
    """``robust`` plans for 8 simulated robots, in a quarter of the time, where a test is not about their number."""
    monkeypatch.setattr("kr270_milling.cell.jobs.PLANNED", 4)


@pytest.fixture(scope="session")
def short_cell():
    from kr270_milling.base.parameter_file import find_file
    from kr270_milling.cell.cell_file import read_cell

    return read_cell(find_file("paper.yaml"), [*SHORT, "publish.every=1"])


@pytest.fixture(scope="session")
def ran(short_cell):
    """The result of its pass along the target."""
    from kr270_milling.cell.jobs import simulate

    return simulate(short_cell).result


@pytest.fixture(scope="session")
def browser():
    """One Chromium for all tests of pages."""
    from browser import started_browser

    with started_browser() as running:
        yield running


@pytest.fixture(scope="session")
def demo(tmp_path_factory):
    """``kr270_milling demo --plain``, run once: its passes, its printed tables and its JSON."""
    from kr270_milling.cli import main
    from kr270_milling.show.commands import run as command

    calls, answer = [], command._answer
    directory = str(tmp_path_factory.mktemp("demo") / "out")
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()) as text:
        patch.setattr(command, "_answer", lambda *arguments: calls.append(arguments) or answer(*arguments))
        assert main(["demo", "--plain", "--out", directory]) == 0
    with contextlib.redirect_stdout(io.StringIO()) as as_json, answer_of("demo"):
        answer(*calls[0]).print(as_json=True)
    passes, printed = {p.name: p for p in calls[0][0]}, json.loads(as_json.getvalue())
    return SimpleNamespace(passes=passes, text=text.getvalue(), json=printed, directory=directory)


@pytest.fixture
def world(domain):
    """Nodes in one context, stepped by hand."""
    pytest.importorskip("rclpy")
    from kr270_milling.live.ros.environment import keep_to_this_host

    keep_to_this_host()
    with contextlib.closing(World(domain)) as made:
        yield made


class World:
    """A context, an executor and the nodes in it."""

    def __init__(self, domain: int):
        import rclpy
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.signals import SignalHandlerOptions

        self.context = Context()
        rclpy.init(args=[], context=self.context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.nodes: list = []
        self.caller = None  # the node that calls services

    def add(self, kind, *arguments: str, cell=None, directory: Path | None = None, **kwargs):
        """A node of this package; arguments as behind --ros-args; cell: its cell_file."""
        from kr270_milling.cell.cell_file import write_cell_file

        arguments = list(arguments)
        if cell is not None:
            file = Path(directory, f"cell_{len(self.nodes)}.yaml")
            write_cell_file(cell, file)
            arguments = ["-p", f"cell_file:={file}", *arguments]
        node = kind(context=self.context, use_global_arguments=False, cli_args=["--ros-args", *arguments], **kwargs)
        return self.take(node)

    def partner(self, name: str = "partner", namespace: str = "/"):
        """A plain node that plays a part of the graph."""
        from rclpy.node import Node

        return self.take(Node(name, namespace=namespace, context=self.context, use_global_arguments=False))

    def take(self, node):
        self.executor.add_node(node)
        self.nodes.append(node)
        return node

    def remove(self, node) -> None:
        """As if its process had ended."""
        self.executor.remove_node(node)
        self.nodes.remove(node)
        self._end(node)

    @staticmethod
    def _end(node) -> None:
        if hasattr(node, "close"):  # the file of a recorder, as its process closes the file
            node.close()
        node.destroy_node()

    def until(self, condition, what: str = ""):
        """Step the nodes until the condition holds; returns its value."""
        end = time.monotonic() + LIMIT
        while not (value := condition()):
            assert time.monotonic() < end, f"not within {LIMIT:g} s: {what or condition}"
            self.executor.spin_once(timeout_sec=0.02)
        return value

    def step(self, seconds: float) -> None:
        """Let wall time pass for what must NOT happen."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.01)

    def listen(self, node, topic, callback=None) -> list:
        """Return the list of all messages that arrive on a topic of the table."""
        messages: list = []
        node.create_subscription(topic.type, topic.name, callback or messages.append, topic.qos)
        return messages

    def request(self, service: str):
        """Call a service without arguments; return its answer."""
        from std_srvs.srv import Trigger

        if self.caller is None:
            self.caller = self.partner("caller")
        client = self.caller.create_client(Trigger, service)
        self.until(client.service_is_ready, service)
        future = client.call_async(Trigger.Request())
        self.until(future.done, service)
        self.caller.destroy_client(client)
        return future.result()

    def diagnostics(self, node) -> Diagnostics:
        return Diagnostics(self, node)

    def close(self) -> None:
        self.executor.shutdown()
        while self.nodes:
            self._end(self.nodes.pop())
        self.context.try_shutdown()


class Diagnostics:
    """The messages of the nodes in /diagnostics."""

    def __init__(self, world: World, node):
        from kr270_milling.live.ros import topics

        self.all: list[tuple[str, int, str]] = []  # node, level, message
        self.last: dict = {}  # node -> values
        self._world = world
        world.listen(node, topics.DIAGNOSTICS, self._take)

    def _take(self, msg) -> None:
        for status in msg.status:
            self.all.append((status.name, status.level[0], status.message))
            self.last[status.name] = {pair.key: pair.value for pair in status.values}

    def reported(self, node: str, text: str, level: int | None = None) -> bool:
        return any(n == node and text in m and level in (None, v) for n, v, m in self.all)

    def until(self, node: str, text: str, level: int | None = None) -> None:
        self._world.until(lambda: self.reported(node, text, level), f"{node}: {text!r}")
