"""A simulated robot controller that runs a path with RSI: one telegram a cycle, the answer of the sensor side back.

``python test/rsi_controller.py TABLE.csv SECONDS PORT`` runs the path of an RSI table in this time, at 4 ms, and prints
how many answers arrived within their cycle.
"""

import contextlib
import re
import socket
import sys
import time

import numpy as np

ANSWER = re.compile(
    r'<Sen Type="ImFree"><RKorr X="(.*?)" Y="(.*?)" Z="(.*?)" A="(.*?)" B="(.*?)" C="(.*?)"/><IPOC>(\d+)</IPOC></Sen>'
)


def telegram(ipoc, point_mm, actual_mm=None, delay=0, abc=(0.0, 90.0, 0.0)) -> bytes:
    def pose(name, p):
        x, y, z = p
        a, b, c = abc
        return f'<{name} X="{x:.4f}" Y="{y:.4f}" Z="{z:.4f}" A="{a:.4f}" B="{b:.4f}" C="{c:.4f}"/>'

    both = pose("RIst", point_mm if actual_mm is None else actual_mm) + pose("RSol", point_mm)
    return f'<Rob Type="KUKA">{both}<Delay D="{delay}"/><IPOC>{ipoc}</IPOC></Rob>'.encode()


class Controller:
    """Sends telegrams to a port of this host."""

    def __init__(self, port: int, timeout: float = 60.0):
        self.port = port
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(timeout)
        self.ipoc = 4_208_163_634
        self.close = self.socket.close

    def send(self, data: bytes) -> None:
        self.socket.sendto(data, ("127.0.0.1", self.port))

    def receive(self) -> tuple[int, np.ndarray]:
        """Return the IPOC and the correction [mm, deg], (6,)."""
        data = self.socket.recv(4096).decode()
        *values, ipoc = ANSWER.fullmatch(data).groups()
        return int(ipoc), np.array(values, float)

    def cycle(self, point_mm, **more) -> np.ndarray:
        """Run one cycle and return the correction [mm, deg], (6,); the counter has 32 bits."""
        self.ipoc = (self.ipoc + 4) % 2**32
        self.send(telegram(self.ipoc, point_mm, **more))
        ipoc, correction = self.receive()
        assert ipoc == self.ipoc
        return correction

    def wait(self, point_mm) -> None:
        """Wait at a point until the sensor side answers."""
        while True:
            self.ipoc += 4
            self.send(telegram(self.ipoc, point_mm))
            with contextlib.suppress(TimeoutError):
                self.receive()
                return

    def has_answer(self) -> bool:
        """Whether an unexpected answer has arrived."""
        self.socket.settimeout(0.1)
        with contextlib.suppress(TimeoutError):
            self.socket.recv(4096)
            return True
        self.socket.settimeout(60.0)
        return False


def run(table, seconds: float, port: int, cycle: float = 4e-3) -> str:
    """Run the path of a table in real time; return a sentence about the answers."""
    place = np.genfromtxt(table, delimiter=",", names=True)
    count = round(seconds / cycle)
    at = np.linspace(place["time_s"][0], place["time_s"][-1], count)
    points = np.column_stack([np.interp(at, place["time_s"], place[f"{axis}_mm"]) for axis in "XYZ"])
    controller, applied = Controller(port, cycle), np.zeros(3)
    controller.wait(points[0])
    took = np.full(count, np.inf)
    begin = time.monotonic()
    for k, point in enumerate(points):
        time.sleep(max(0.0, begin + k * cycle - time.monotonic()))
        sent = time.monotonic()
        controller.ipoc += 4
        controller.send(telegram(controller.ipoc, point, point + applied))
        with contextlib.suppress(TimeoutError):
            while (got := controller.receive())[0] != controller.ipoc:
                pass  # of an earlier cycle
            took[k], applied = time.monotonic() - sent, got[1][:3]
    there = took[np.isfinite(took)]
    return (
        f"{count} cycles in {time.monotonic() - begin:.1f} s: {there.size} answers within the cycle; "
        f"round trip {1e3 * there.mean():.2f} ms in the mean, "
        f"{1e3 * np.percentile(there, 99.9):.2f} ms for 99.9 %, {1e3 * there.max():.2f} ms at most"
    )


if __name__ == "__main__":
    print(run(sys.argv[1], float(sys.argv[2]), int(sys.argv[3])))
