"""``kr270_milling watch``: a page on this host that shows a running graph or a replay; read-only, closes with it."""

from __future__ import annotations

from kr270_milling.commands.console import add_common
from kr270_milling.nodes.option_types import bounded

PORT = 8270
LAST_LOOK = 1.0  #: [s] for an open page to take the last events


def add_arguments(parser) -> None:
    parser.add_argument("--namespace", metavar="NAME", default="", help="ROS namespace of the robot")
    parser.add_argument("--host", default="127.0.0.1", help="where it is served (default: 127.0.0.1, this host alone)")
    parser.add_argument(
        "--port", type=bounded(0, 65535, int), default=PORT, help=f"default: {PORT}; 0: any that is free"
    )
    add_common(parser)


def run(args) -> int:
    import json
    import time

    from kr270_milling.ros.environment import require_ros

    require_ros()
    from kr270_milling.nodes.watcher import Watcher
    from kr270_milling.ros.names import full_namespace
    from kr270_milling.ros.spin import run_node
    from kr270_milling.watch.page import page
    from kr270_milling.watch.server import Events, serve

    namespace = full_namespace(args.namespace, "--namespace") if args.namespace else ""
    page()  # made before the first look
    events = Events()
    server = serve(events, args.host, args.port)
    url = f"http://{args.host}:{server.server_port}/"
    print(
        json.dumps({"url": url}) if args.json else f"live view: {url} (Ctrl-C ends it; it ends with the graph)",
        flush=True,
    )
    try:
        code = run_node(lambda **kwargs: Watcher(events, namespace, **kwargs), [])
        if not events.ended:
            events.tell({"kind": "end"})
        time.sleep(LAST_LOOK)
    finally:
        server.shutdown()
        server.server_close()
    return code
