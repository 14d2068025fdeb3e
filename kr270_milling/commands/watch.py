"""``kr270_milling watch``: a page on this host that shows a running graph or a replay; read-only, closes with it."""

from __future__ import annotations

from kr270_milling.commands.options import option
from kr270_milling.nodes.option_types import bounded

PORT = 8270
LAST_LOOK = 1.0  #: [s] for an open page to take the last events


def add_arguments(parser) -> None:
    option(parser, "--namespace NAME", "ROS namespace of the robot", default="")
    option(parser, "--host", "where it is served (default: 127.0.0.1, this host alone)", default="127.0.0.1")
    option(parser, "--port", f"default: {PORT}; 0: any that is free", bounded(0, 65535, int), PORT)


def run(args) -> int:
    """The address is printed while the page is served: nothing is left to say at the end."""
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
    text = json.dumps({"url": url}) if args.json else f"live view: {url} (Ctrl-C ends it; it ends with the graph)"
    print(text, flush=True)
    try:
        code = run_node(lambda **kwargs: Watcher(events, namespace, **kwargs), [])
        if not events.ended:
            events.tell({"kind": "end"})
        time.sleep(LAST_LOOK)
    finally:
        server.shutdown()
        server.server_close()
    return code
